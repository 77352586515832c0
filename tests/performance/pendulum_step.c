/* The paper's pendulum, steps (H4) to (H8) of THEORY.md by hand: reaction implicit, b = 0, constant h, full Newton.
 *
 * Unknowns: a (3), lam0 (2), lam1 (2).  Exact derivatives, a new matrix at every iteration, the last step's unknowns as guess.
 */
#define SIZE 7
#include "elimination.h"

typedef struct { double m, L, k, c, g; } Pendulum;

static const double REST = 4.71238898038468985769396507491925432629575409906266; /* hanging [rad] */

/* `steps` steps from q, v (in place); lam: guess of both multipliers.  Returns the iterations of Newton, or -1. */
long pendulum_steps(const Pendulum *p, double h, double alpha, long steps, double *q, double *v, const double *lam)
{
    const double beta = 0.25 * (1 - alpha) * (1 - alpha), gamma = 0.5 - alpha, half = 0.5 * h * h;
    const double inertia = p->m * p->L * p->L / 3, wm = 1 / p->m, wi = 1 / inertia, one = 1 + alpha;
    const double spring = p->k * wi, damper = p->c * wi, q_a = 2 * beta * half, v_a = gamma * h, L = p->L;
    double x[SIZE], f[3] = {0, -p->g, -damper * v[2] - spring * (q[2] - REST)};
    double q_size = larger(0, q, 3), v_size = larger(0, v, 3), s = sin(q[2]), c = cos(q[2]);
    long iterations = 0;
    for (int i = 0; i < 3; i++) x[i] = f[i];
    for (int i = 0; i < 4; i++) x[3 + i] = lam[i & 1];
    double a0[3] = {f[0], f[1], f[2]};
    for (long step = 0; step < steps; step++) {
        double q1[3], v1[3], qk[3], vk[3], last = INFINITY;
        const double Ls0 = L * s, Lc0 = L * c;
        for (int i = 0; i < 3; i++) {
            qk[i] = q[i] + h * v[i] + half * (1 - 2 * beta) * a0[i];
            vk[i] = v[i] + h * (1 - gamma) * a0[i];
            f[i] *= alpha;
        }
        q_size = fmax(q_size, fabs(h) * v_size);
        for (int tries = 0;; tries++) {
            if (tries == 15) return -1;
            const double *lam0 = x + 3, *lam1 = x + 5;
            const double R0[3] = {-wm * lam0[0], -wm * lam0[1], -wi * (Ls0 * lam0[0] - Lc0 * lam0[1])};
            for (int i = 0; i < 3; i++) q1[i] = qk[i] + q_a * x[i] + half * R0[i];
            s = sin(q1[2]), c = cos(q1[2]);
            const double Ls = L * s, Lc = L * c, pull = Ls * lam1[0] - Lc * lam1[1];
            const double R1[3] = {-wm * lam1[0], -wm * lam1[1], -wi * pull};
            for (int i = 0; i < 3; i++) v1[i] = vk[i] + v_a * x[i] + 0.5 * h * (R0[i] + R1[i]);
            /* dq1/dx and dv1/dx: columns a, lam0, lam1; only the third row of v1 feels q1, through R1 */
            const double turn = -wi * (Lc * lam1[0] + Ls * lam1[1]) * 0.5 * h;
            const double q3[5] = {q_a, -half * wi * Ls0, half * wi * Lc0, 0, 0}; /* by a3, lam0, lam1 */
            const double v3[5] = {v_a + turn * q3[0], -0.5 * h * wi * Ls0 + turn * q3[1], 0.5 * h * wi * Lc0 + turn * q3[2],
                                  -0.5 * h * wi * Ls, 0.5 * h * wi * Lc};
            const double vl = -0.5 * h * wm, P = 2 / (h * h), V = 1 / h;
            double A[SIZE][SIZE] = {{0}}, b[SIZE];
            for (int i = 0; i < 3; i++) b[i] = x[i] + f[i];
            b[1] += one * p->g;
            b[2] += one * (damper * v1[2] + spring * (q1[2] - REST));
            b[3] = P * (q1[0] - Lc);
            b[4] = P * (q1[1] - Ls);
            b[5] = V * (v1[0] + Ls * v1[2]);
            b[6] = V * (v1[1] - Lc * v1[2]);
            A[0][0] = A[1][1] = A[2][2] = 1;
            A[3][0] = A[4][1] = P * q_a;
            A[3][3] = A[4][4] = -P * half * wm;
            A[5][0] = A[6][1] = V * v_a;
            A[5][3] = A[6][4] = A[5][5] = A[6][6] = V * vl;
            for (int j = 0; j < 5; j++) { /* the columns a3, lam0, lam1 */
                A[2][2 + j] += one * (damper * v3[j] + spring * q3[j]);
                A[3][2 + j] += P * Ls * q3[j];
                A[4][2 + j] -= P * Lc * q3[j];
                A[5][2 + j] += V * (Ls * v3[j] + Lc * v1[2] * q3[j]);
                A[6][2 + j] -= V * (Lc * v3[j] - Ls * v1[2] * q3[j]);
            }
            if (!eliminate(A, b)) return -1;
            double q_moved = 0, v_moved = 0, dq[3], dv[3];
            for (int i = 0; i < 2; i++) {
                dq[i] = q_a * b[i] - half * wm * b[3 + i];
                dv[i] = v_a * b[i] + vl * (b[3 + i] + b[5 + i]);
            }
            dq[2] = dv[2] = 0;
            for (int j = 0; j < 5; j++) dq[2] += q3[j] * b[2 + j], dv[2] += v3[j] * b[2 + j];
            q_moved = larger(0, dq, 3), v_moved = larger(0, dv, 3);
            for (int i = 0; i < SIZE; i++) x[i] -= b[i];
            iterations++;
            double moved = fmax(q_moved / q_size, v_moved / v_size);
            if (!(q_moved < INFINITY && v_moved < INFINITY)) return -1;
            for (int i = 0; i < 3; i++) q1[i] -= dq[i], v1[i] -= dv[i];
            if (converged(moved, last)) break;
            last = moved;
        }
        for (int i = 0; i < 3; i++) q[i] = q1[i], v[i] = v1[i], a0[i] = x[i];
        s = sin(q[2]), c = cos(q[2]);
        f[0] = 0, f[1] = -p->g, f[2] = -damper * v[2] - spring * (q[2] - REST);
        q_size = larger(q_size, q, 3), v_size = larger(v_size, v, 3);
    }
    return iterations;
}
