/* Andrews' squeezing mechanism, steps (H4) to (H8) of THEORY.md by hand: reaction implicit, b = 0, constant h, full Newton.
 *
 * Unknowns: a (7), R1 (7), lam0 (6), lam1 (6).  Exact derivatives, a new matrix at every iteration, the last step's unknowns
 * as guess.  Angles in the order beta, Theta, gamma, Phi, delta, Omega, epsilon; the lengths are those of problems/andrews.py.
 */
#define SIZE 26
#include "elimination.h"

#define N 7
#define M 6

static const double xa = -.06934, ya = -.00227, xb = -.03635, yb = .03273, xc = .014, yc = .072, c0 = 4530, l0 = .07785;
static const double d = .028, e = .02, rr = .007, ss = .035, sc = .018, sd = .02, u = .04, zf = .02, zt = .04, mom = .033;
/* moments of the mass matrix: m2 da rr, m4 zt (e - ea), m6 u (zf - fa), and what does not move */
static const double k1 = .00365 * .0115 * .007, k2 = .00706 * .04 * (.02 - .01421), k3 = .00706 * .04 * (.02 - .01421);
static const double m22 = .00365 * .0115 * .0115 + 4.410e-7, m33 = .02373 * (.01874 * .01874 + .01043 * .01043) + 5.255e-6;
static const double m11 = .04325 * .00092 * .00092 + .00365 * .007 * .007 + 2.194e-6;
static const double m44 = .00706 * (.02 - .01421) * (.02 - .01421) + 5.667e-7, m66 = .00706 * (.02 - .01421) * (.02 - .01421) + 5.667e-7;
static const double m55 = .00706 * .04 * .04 + .07050 * (.02308 * .02308 + .00916 * .00916) + 1.169e-5;
static const double m77 = .00706 * .04 * .04 + .05498 * (.01228 * .01228 + .00449 * .00449) + 1.912e-5;

typedef struct { /* sines and cosines of one position, and what is made of them */
    double mass[4][3]; /* of the pairs (0,1), (3,4), (5,6): m_ii, m_ij, m_jj; [3][0] is m_33 of gamma */
    double mass_1, mass_2, mass_3; /* derivatives of the off-diagonals by Theta, Phi, Omega */
    double G[M][N], g[M];
    double xbb, xbT, ybb, ybT, xgg, ygg, xPP, yPP, xdd, ydd, xOO, yOO, xee, yee; /* second derivatives of g */
    double s1, c1, s2, c2, s3, c3, spring, stiffness;
} Place;

static void locate(const double *q, Place *p)
{
    const double sb = rr * sin(q[0]), cb = rr * cos(q[0]), sT = d * sin(q[0] + q[1]), cT = d * cos(q[0] + q[1]);
    const double sg = sin(q[2]), cg = cos(q[2]), sP = e * sin(q[3] + q[4]), cP = e * cos(q[3] + q[4]), sd_ = zt * sin(q[4]);
    const double cd_ = zt * cos(q[4]), sO = zf * sin(q[5] + q[6]), cO = zf * cos(q[5] + q[6]), se = u * sin(q[6]);
    const double ce = u * cos(q[6]), x = cb - cT, y = sb - sT;
    p->s1 = k1 * sin(q[1]), p->c1 = k1 * cos(q[1]), p->s2 = k2 * sin(q[3]), p->c2 = k2 * cos(q[3]);
    p->s3 = k3 * sin(q[5]), p->c3 = k3 * cos(q[5]);
    const double m12 = m22 - p->c1, m45 = m44 + p->s2, m67 = m66 - p->s3;
    const double mass[4][3] = {{m11 + 2 * m12 - m22, m12, m22}, {m44, m45, m55 + 2 * m45 - m44},
                               {m66, m67, m77 + 2 * m67 - m66}, {m33, 0, 0}};
    for (int i = 0; i < 4; i++) for (int j = 0; j < 3; j++) p->mass[i][j] = mass[i][j];
    p->mass_1 = p->s1, p->mass_2 = p->c2, p->mass_3 = -p->c3;
    const double g[M] = {x - ss * sg - xb, y + ss * cg - yb, x - sP - cd_ - xa, y + cP - sd_ - ya, x - cO - se - xa, y - sO + ce - ya};
    const double G[M][N] = {{sT - sb, sT, -ss * cg}, {cb - cT, -cT, -ss * sg},
                            {sT - sb, sT, 0, -cP, sd_ - cP}, {cb - cT, -cT, 0, -sP, -sP - cd_},
                            {sT - sb, sT, 0, 0, 0, sO, sO - ce}, {cb - cT, -cT, 0, 0, 0, -cO, -cO - se}};
    for (int i = 0; i < M; i++) {
        p->g[i] = g[i];
        for (int j = 0; j < N; j++) p->G[i][j] = G[i][j];
    }
    p->xbb = cT - cb, p->xbT = cT, p->ybb = sT - sb, p->ybT = sT, p->xgg = ss * sg, p->ygg = -ss * cg;
    p->xPP = sP, p->yPP = -cP, p->xdd = sP + cd_, p->ydd = sd_ - cP, p->xOO = cO, p->yOO = sO, p->xee = cO + se, p->yee = sO - ce;
    const double ax = sd * cg + sc * sg, ay = sd * sg - sc * cg, Dx = ax + xb - xc, Dy = ay + yb - yc;
    const double length = sqrt(Dx * Dx + Dy * Dy), turn = ax * Dy - ay * Dx, part = c0 * (1 - l0 / length);
    p->spring = -part * turn;
    p->stiffness = c0 * l0 / (length * length * length) * turn * turn + part * (sd * sd + sc * sc - Dx * ax - Dy * ay);
}

static const int FIRST[3] = {0, 3, 5};

static void multiply(const Place *p, const double *x, double *y) /* y = M x */
{
    for (int k = 0; k < 3; k++) {
        const int i = FIRST[k];
        y[i] = p->mass[k][0] * x[i] + p->mass[k][1] * x[i + 1];
        y[i + 1] = p->mass[k][1] * x[i] + p->mass[k][2] * x[i + 1];
    }
    y[2] = m33 * x[2];
}

static void divide(const Place *p, double *x) /* x = M^-1 x */
{
    for (int k = 0; k < 3; k++) {
        const int i = FIRST[k];
        const double *m = p->mass[k], w = 1 / (m[0] * m[2] - m[1] * m[1]), y = x[i];
        x[i] = w * (m[2] * y - m[1] * x[i + 1]);
        x[i + 1] = w * (m[0] * x[i + 1] - m[1] * y);
    }
    x[2] /= m33;
}

static void force(const Place *p, const double *v, double *F)
{
    F[0] = mom - p->s1 * v[1] * (v[1] + 2 * v[0]), F[1] = p->s1 * v[0] * v[0], F[2] = p->spring;
    F[3] = p->c2 * v[4] * v[4], F[4] = -p->c2 * v[3] * (v[3] + 2 * v[4]);
    F[5] = -p->c3 * v[6] * v[6], F[6] = p->c3 * v[5] * (v[5] + 2 * v[6]);
}

static void add_force_jacobians(const Place *p, const double *v, double w, double Q[N][N], double V[N][N]) /* w F_q, w F_v */
{
    const double s1 = w * p->s1, c1 = w * p->c1, s2 = w * p->s2, c2 = w * p->c2, s3 = w * p->s3, c3 = w * p->c3;
    Q[0][1] -= c1 * v[1] * (v[1] + 2 * v[0]), Q[1][1] += c1 * v[0] * v[0], Q[2][2] -= w * p->stiffness;
    Q[3][3] -= s2 * v[4] * v[4], Q[4][3] += s2 * v[3] * (v[3] + 2 * v[4]);
    Q[5][5] += s3 * v[6] * v[6], Q[6][5] -= s3 * v[5] * (v[5] + 2 * v[6]);
    V[0][0] -= 2 * s1 * v[1], V[0][1] -= 2 * s1 * (v[0] + v[1]), V[1][0] += 2 * s1 * v[0];
    V[3][4] += 2 * c2 * v[4], V[4][3] -= 2 * c2 * (v[3] + v[4]), V[4][4] -= 2 * c2 * v[3];
    V[5][6] -= 2 * c3 * v[6], V[6][5] += 2 * c3 * (v[5] + v[6]), V[6][6] += 2 * c3 * v[5];
}

static void add_mass_jacobian(const Place *p, const double *x, double Q[N][N]) /* (M x)_q */
{
    Q[0][1] += p->mass_1 * (2 * x[0] + x[1]), Q[1][1] += p->mass_1 * x[0];
    Q[3][3] += p->mass_2 * x[4], Q[4][3] += p->mass_2 * (x[3] + 2 * x[4]);
    Q[5][5] += p->mass_3 * x[6], Q[6][5] += p->mass_3 * (x[5] + 2 * x[6]);
}

static void add_curvature(const Place *p, const double *l, double Q[N][N]) /* (G^T lam)_q */
{
    const double x = l[0] + l[2] + l[4], y = l[1] + l[3] + l[5], b = x * p->xbT + y * p->ybT;
    const double P = l[2] * p->xPP + l[3] * p->yPP, O = l[4] * p->xOO + l[5] * p->yOO;
    Q[0][0] += x * p->xbb + y * p->ybb, Q[0][1] += b, Q[1][0] += b, Q[1][1] += b, Q[2][2] += l[0] * p->xgg + l[1] * p->ygg;
    Q[3][3] += P, Q[3][4] += P, Q[4][3] += P, Q[4][4] += l[2] * p->xdd + l[3] * p->ydd;
    Q[5][5] += O, Q[5][6] += O, Q[6][5] += O, Q[6][6] += l[4] * p->xee + l[5] * p->yee;
}

static void velocity_jacobian(const Place *p, const double *v, double H[M][N]) /* (G v)_q */
{
    const double P = v[3] + v[4], O = v[5] + v[6], bT = v[0] + v[1];
    for (int i = 0; i < M; i += 2) {
        H[i][0] = p->xbb * v[0] + p->xbT * v[1], H[i][1] = p->xbT * bT;
        H[i + 1][0] = p->ybb * v[0] + p->ybT * v[1], H[i + 1][1] = p->ybT * bT;
    }
    H[0][2] = p->xgg * v[2], H[1][2] = p->ygg * v[2];
    H[2][3] = p->xPP * P, H[3][3] = p->yPP * P, H[2][4] = p->xPP * v[3] + p->xdd * v[4], H[3][4] = p->yPP * v[3] + p->ydd * v[4];
    H[4][5] = p->xOO * O, H[5][5] = p->yOO * O, H[4][6] = p->xOO * v[5] + p->xee * v[6], H[5][6] = p->yOO * v[5] + p->yee * v[6];
}

typedef struct { double h, alpha, q_a, v_a, qk[N], vk[N], f0[N], W[N][M]; } Known;

/* Columns of a row block that depends on q1 by Q and on v1 by V; `zero` are its own derivatives by a. */
static void chain(const Known *k, double Q[N][N], double V[N][N], double A[SIZE][SIZE], int row)
{
    const double half = 0.5 * k->h * k->h;
    for (int i = 0; i < N; i++) {
        double R[N];
        for (int j = 0; j < N; j++) {
            A[row + i][j] = k->q_a * Q[i][j] + k->v_a * V[i][j];
            A[row + i][N + j] = 0.5 * k->h * V[i][j];
            R[j] = half * Q[i][j] + 0.5 * k->h * V[i][j];
        }
        for (int l = 0; l < M; l++) {
            double sum = 0;
            for (int j = 0; j < N; j++) sum -= R[j] * k->W[j][l];
            A[row + i][2 * N + l] = sum;
            A[row + i][2 * N + M + l] = 0;
        }
    }
}

static void add_mass(const Place *p, double A[SIZE][SIZE], int row, int column)
{
    for (int k = 0; k < 3; k++) {
        const int i = row + FIRST[k], j = column + FIRST[k];
        A[i][j] += p->mass[k][0], A[i][j + 1] += p->mass[k][1], A[i + 1][j] += p->mass[k][1], A[i + 1][j + 1] += p->mass[k][2];
    }
    A[row + 2][column + 2] += m33;
}

static void assemble(const Known *k, const Place *p, const double *x, const double *v1, double A[SIZE][SIZE], double b[SIZE])
{
    const double *R1 = x + N, *lam1 = x + 2 * N + M, h = k->h, position = 2 / (h * h), velocity = 1 / h;
    double w[N], F[N], Mw[N], MR[N], Q[N][N] = {{0}}, V[N][N] = {{0}}, Q2[N][N] = {{0}}, V2[N][N] = {{0}}, H[M][N] = {{0}};
    for (int i = 0; i < N; i++) w[i] = x[i] + k->alpha * k->f0[i];
    multiply(p, w, Mw);
    multiply(p, R1, MR);
    force(p, v1, F);
    add_force_jacobians(p, v1, -(1 + k->alpha), Q, V);
    add_mass_jacobian(p, w, Q);
    add_mass_jacobian(p, R1, Q2);
    add_curvature(p, lam1, Q2);
    velocity_jacobian(p, v1, H);
    chain(k, Q, V, A, 0);
    chain(k, Q2, V2, A, N);
    add_mass(p, A, 0, 0);
    add_mass(p, A, N, N);
    for (int i = 0; i < N; i++) {
        b[i] = Mw[i] - (1 + k->alpha) * F[i];
        b[N + i] = MR[i];
        for (int l = 0; l < M; l++) b[N + i] += p->G[l][i] * lam1[l], A[N + i][2 * N + M + l] = p->G[l][i];
    }
    for (int i = 0; i < M; i++) {
        double *P = A[2 * N + i], *S = A[2 * N + M + i], Gv = 0, at_q[N], at_v[N];
        for (int j = 0; j < N; j++) {
            const double G = p->G[i][j];
            Gv += G * v1[j];
            P[j] = position * k->q_a * G, P[N + j] = 0;
            S[j] = velocity * (k->q_a * H[i][j] + k->v_a * G), S[N + j] = 0.5 * G;
            at_q[j] = -G, at_v[j] = -0.5 * (h * H[i][j] + G);
        }
        for (int l = 0; l < M; l++) {
            double q = 0, v = 0;
            for (int j = 0; j < N; j++) q += at_q[j] * k->W[j][l], v += at_v[j] * k->W[j][l];
            P[2 * N + l] = q, P[2 * N + M + l] = 0, S[2 * N + l] = v, S[2 * N + M + l] = 0;
        }
        b[2 * N + i] = position * p->g[i];
        b[2 * N + M + i] = velocity * Gv;
    }
}

/* q1, v1 from the unknowns, or with zero known values their change from a change of the unknowns. */
static void ends(const Known *k, const double *qk, const double *vk, const double *x, double *q1, double *v1)
{
    const double h = k->h, half = 0.5 * h * h, *R1 = x + N, *lam0 = x + 2 * N;
    for (int i = 0; i < N; i++) {
        double R0 = 0;
        for (int l = 0; l < M; l++) R0 -= k->W[i][l] * lam0[l];
        q1[i] = qk[i] + k->q_a * x[i] + half * R0;
        v1[i] = vk[i] + k->v_a * x[i] + 0.5 * h * (R0 + R1[i]);
    }
}

static long iterate(const Known *k, double *x, Place *p, double *q1, double *v1, double q_size, double v_size)
{
    const double nothing[N] = {0};
    double A[SIZE][SIZE], b[SIZE], dq[N], dv[N], last = INFINITY;
    ends(k, k->qk, k->vk, x, q1, v1);
    for (long tries = 1; tries <= 15; tries++) {
        locate(q1, p);
        assemble(k, p, x, v1, A, b);
        if (!eliminate(A, b)) return -1;
        ends(k, nothing, nothing, b, dq, dv);
        for (int i = 0; i < SIZE; i++) x[i] -= b[i];
        for (int i = 0; i < N; i++) q1[i] -= dq[i], v1[i] -= dv[i];
        const double q_moved = larger(0, dq, N) / q_size, v_moved = larger(0, dv, N) / v_size, moved = fmax(q_moved, v_moved);
        if (!(q_moved < INFINITY && v_moved < INFINITY)) return -1;
        if (converged(moved, last)) return tries;
        last = moved;
    }
    return -1;
}

/* `steps` steps from q, v (in place); lam: guess of both multipliers.  Returns the iterations of Newton, or -1. */
long andrews_steps(double h, double alpha, long steps, double *q, double *v, const double *lam)
{
    const double beta = 0.25 * (1 - alpha) * (1 - alpha), gamma = 0.5 - alpha, half = 0.5 * h * h;
    double x[SIZE] = {0}, q1[N], v1[N], q_size = larger(0, q, N), v_size = larger(0, v, N);
    Known k = {.h = h, .alpha = alpha, .q_a = 2 * beta * half, .v_a = gamma * h};
    Place p;
    long iterations = 0;
    locate(q, &p);
    force(&p, v, k.f0);
    divide(&p, k.f0);
    for (int i = 0; i < N; i++) x[i] = k.f0[i];
    for (int i = 0; i < M; i++) x[2 * N + i] = x[2 * N + M + i] = lam[i];
    for (long step = 0; step < steps; step++) {
        v_size = fmax(v_size, fabs(h) * larger(0, x, N)); /* from rest */
        q_size = fmax(q_size, fabs(h) * v_size);
        for (int i = 0; i < N; i++) {
            k.qk[i] = q[i] + h * v[i] + half * (1 - 2 * beta) * x[i];
            k.vk[i] = v[i] + h * (1 - gamma) * x[i];
        }
        for (int l = 0; l < M; l++) { /* R0 = -W lam0 */
            double column[N];
            for (int i = 0; i < N; i++) column[i] = p.G[l][i];
            divide(&p, column);
            for (int i = 0; i < N; i++) k.W[i][l] = column[i];
        }
        const long taken = iterate(&k, x, &p, q1, v1, q_size, v_size);
        if (taken < 0) return -1;
        iterations += taken;
        for (int i = 0; i < N; i++) q[i] = q1[i], v[i] = v1[i];
        locate(q, &p);
        force(&p, v, k.f0);
        divide(&p, k.f0);
        q_size = larger(q_size, q, N), v_size = larger(v_size, v, N);
    }
    return iterations;
}
