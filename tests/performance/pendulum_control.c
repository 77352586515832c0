/* The paper's pendulum under error control by hand: the step of pendulum_step.c, the local error (H23) to (H28) of THEORY.md
 * along the constraints, filtered by the last matrix of Newton's iteration, and the proportional-integral controller.
 *
 * Unknowns: a (3), lam0 (2), lam1 (2).  Exact derivatives, a new matrix at every iteration, the last step's unknowns as guess.
 */
#define SIZE 7
#include "elimination.h"

typedef struct { double m, L, k, c, g; } Pendulum;
/* Where a run stands between two steps: the state, (H11), and what the estimate and the controller remember, (H24). */
typedef struct { double t, h, h_next, last, error, q[3], v[3], a[3], lam[2], earlier[3], acceleration[3]; } State;
typedef struct { double q3[5], v3[5]; } Turn; /* third rows of dq1/dx and dv1/dx: columns a3, lam0, lam1 */
typedef struct { double A[SIZE][SIZE]; int pivot[SIZE]; Turn turn; } Matrix;
typedef struct { double L, g, wm, wi, spring, damper, one, beta, gamma, h, half, q_a, v_a, vl, P, V; } Step;

static const double REST = 4.71238898038468985769396507491925432629575409906266; /* hanging [rad] */
static const double GAUSS = 0.78867513459481288225457439025097872782380087563506; /* of a step: dense output errs most */
static const double TARGET = 0.6, SHRINK = 0.2, GROWTH = 1.5, LEAST = 1e-4, KEEP_LOW = 0.9, KEEP_HIGH = 1.15;

static Step step_of(const Pendulum *p, double alpha, double h)
{
    const double inertia = p->m * p->L * p->L / 3, wm = 1 / p->m, wi = 1 / inertia;
    const double beta = 0.25 * (1 - alpha) * (1 - alpha), gamma = 0.5 - alpha, half = 0.5 * h * h;
    return (Step){p->L, p->g, wm, wi, p->k * wi, p->c * wi, 1 + alpha, beta, gamma, h, half, 2 * beta * half, gamma * h,
                  -0.5 * h * wm, 2 / (h * h), 1 / h};
}

/* g and its derivative in time at q, v. */
static void levels(const Step *o, const double *q, const double *v, double *g)
{
    const double Ls = o->L * sin(q[2]), Lc = o->L * cos(q[2]);
    g[0] = q[0] - Lc, g[1] = q[1] - Ls, g[2] = v[0] + Ls * v[2], g[3] = v[1] - Lc * v[2];
}

/* What x changes in q1 and v1. */
static void increments(const Step *o, const Turn *turn, const double *x, double *dq, double *dv)
{
    for (int i = 0; i < 2; i++) {
        dq[i] = o->q_a * x[i] - o->half * o->wm * x[3 + i];
        dv[i] = o->v_a * x[i] + o->vl * (x[3 + i] + x[5 + i]);
    }
    dq[2] = dv[2] = 0;
    for (int j = 0; j < 5; j++) dq[2] += turn->q3[j] * x[2 + j], dv[2] += turn->v3[j] * x[2 + j];
}

/* Root mean square of an error of q and v over what is allowed. */
static double size_of(const double *eq, const double *ev, const double *weights)
{
    double total = 0;
    for (int i = 0; i < 3; i++) {
        const double a = eq[i] / weights[i], b = ev[i] / weights[3 + i];
        total += a * a + b * b;
    }
    return sqrt(total / 6);
}

/* One step of o->h from s with the force f: the unknowns x (in: the guess), q1, v1.  Returns the iterations, or -1. */
static int newton(const Step *o, double alpha, const State *s, const double *f, const double *a0, double *x, double *q1,
                  double *v1, double q_size, double v_size, Matrix *J)
{
    double qk[3], vk[3], fa[3], last = INFINITY;
    const double h = o->h, L = o->L, wm = o->wm, wi = o->wi, Ls0 = L * sin(s->q[2]), Lc0 = L * cos(s->q[2]);
    for (int i = 0; i < 3; i++) {
        qk[i] = s->q[i] + h * s->v[i] + o->half * (1 - 2 * o->beta) * a0[i];
        vk[i] = s->v[i] + h * (1 - o->gamma) * a0[i];
        fa[i] = alpha * f[i];
    }
    for (int tries = 1; tries <= 15; tries++) {
        const double *lam0 = x + 3, *lam1 = x + 5;
        const double R0[3] = {-wm * lam0[0], -wm * lam0[1], -wi * (Ls0 * lam0[0] - Lc0 * lam0[1])};
        for (int i = 0; i < 3; i++) q1[i] = qk[i] + o->q_a * x[i] + o->half * R0[i];
        const double sn = sin(q1[2]), cs = cos(q1[2]), Ls = L * sn, Lc = L * cs, pull = Ls * lam1[0] - Lc * lam1[1];
        const double R1[3] = {-wm * lam1[0], -wm * lam1[1], -wi * pull};
        for (int i = 0; i < 3; i++) v1[i] = vk[i] + o->v_a * x[i] + 0.5 * h * (R0[i] + R1[i]);
        const double turn = -wi * (Lc * lam1[0] + Ls * lam1[1]) * 0.5 * h;
        const double q3[5] = {o->q_a, -o->half * wi * Ls0, o->half * wi * Lc0, 0, 0};
        const double v3[5] = {o->v_a + turn * q3[0], -0.5 * h * wi * Ls0 + turn * q3[1], 0.5 * h * wi * Lc0 + turn * q3[2],
                              -0.5 * h * wi * Ls, 0.5 * h * wi * Lc};
        double(*A)[SIZE] = J->A, b[SIZE], dq[3], dv[3];
        for (int i = 0; i < SIZE; i++)
            for (int j = 0; j < SIZE; j++) A[i][j] = 0;
        for (int i = 0; i < 3; i++) b[i] = x[i] + fa[i];
        b[1] += o->one * o->g;
        b[2] += o->one * (o->damper * v1[2] + o->spring * (q1[2] - REST));
        b[3] = o->P * (q1[0] - Lc), b[4] = o->P * (q1[1] - Ls);
        b[5] = o->V * (v1[0] + Ls * v1[2]), b[6] = o->V * (v1[1] - Lc * v1[2]);
        A[0][0] = A[1][1] = A[2][2] = 1;
        A[3][0] = A[4][1] = o->P * o->q_a;
        A[3][3] = A[4][4] = -o->P * o->half * wm;
        A[5][0] = A[6][1] = o->V * o->v_a;
        A[5][3] = A[6][4] = A[5][5] = A[6][6] = o->V * o->vl;
        for (int j = 0; j < 5; j++) { /* the columns a3, lam0, lam1 */
            J->turn.q3[j] = q3[j], J->turn.v3[j] = v3[j];
            A[2][2 + j] += o->one * (o->damper * v3[j] + o->spring * q3[j]);
            A[3][2 + j] += o->P * Ls * q3[j];
            A[4][2 + j] -= o->P * Lc * q3[j];
            A[5][2 + j] += o->V * (Ls * v3[j] + Lc * v1[2] * q3[j]);
            A[6][2 + j] -= o->V * (Lc * v3[j] - Ls * v1[2] * q3[j]);
        }
        if (!factorise(A, J->pivot)) return -1;
        solve(A, J->pivot, b);
        increments(o, &J->turn, b, dq, dv);
        const double q_moved = larger(0, dq, 3), v_moved = larger(0, dv, 3), moved = fmax(q_moved / q_size, v_moved / v_size);
        if (!(q_moved < INFINITY && v_moved < INFINITY)) return -1;
        for (int i = 0; i < SIZE; i++) x[i] -= b[i];
        for (int i = 0; i < 3; i++) q1[i] -= dq[i], v1[i] -= dv[i];
        if (converged(moved, last)) return tries;
        last = moved;
    }
    return -1;
}

/* The integral over [0, h] of the quadratic through the values at -last, 0 and h, (H25). */
static double parabola(double last, double h, double earliest, double start, double end)
{
    const double back = -(h * h * h) / (6 * last * (last + h)), ahead = h * (2 * h + 3 * last) / (6 * (h + last));
    return back * earliest + (h - back - ahead) * start + ahead * end;
}

/* The size of the local error of the step to x, q1, v1, (H26), and f + r at its end in `end`. */
static double estimate(const Step *o, double alpha, const State *s, const double *a0, const double *x, const double *q1,
                       const double *v1, double rtol, const double *atol, double q_size, double v_size, const Matrix *J,
                       double *end)
{
    const double h = o->h, Ls = o->L * sin(q1[2]), Lc = o->L * cos(q1[2]), Ls0 = o->L * sin(s->q[2]), Lc0 = o->L * cos(s->q[2]);
    const double share = h / (h + s->h), *lam0 = x + 3, *lam1 = x + 5, in_v = h * o->gamma;
    double lam[2], weights[6], tau = 1, eq[3], ev[3], inside_q[3], inside_v[3], at_q[3], at_v[3], g[4];
    for (int i = 0; i < 2; i++) lam[i] = lam1[i] + share * (lam0[i] - s->lam[i]);
    end[0] = -o->wm * lam[0], end[1] = -o->g - o->wm * lam[1];
    end[2] = -o->damper * v1[2] - o->spring * (q1[2] - REST) - o->wi * (Ls * lam[0] - Lc * lam[1]);
    const double R[3] = {-o->wm * (lam1[0] - lam0[0]), -o->wm * (lam1[1] - lam0[1]),
                         -o->wi * (Ls * lam1[0] - Lc * lam1[1] - Ls0 * lam0[0] + Lc0 * lam0[1])};
    double first[SIZE] = {0}, second[SIZE] = {0}, unused[3];
    for (int i = 0; i < 3; i++) {
        first[i] = ((1 + 3 * alpha * alpha) / 12 * (x[i] - a0[i]) - R[i] / 6) / o->beta;
        second[i] = (v1[i] - s->v[i] - parabola(s->last, h, s->earlier[i], s->acceleration[i], end[i])) / in_v;
        weights[i] = rtol * fmax(fabs(s->q[i]), fabs(q1[i])) + atol[i];
        weights[3 + i] = rtol * fmax(fabs(s->v[i]), fabs(v1[i])) + atol[3 + i];
        tau = fmin(tau, fmin(rtol + atol[i] / q_size, rtol + atol[3 + i] / v_size));
    }
    solve(J->A, J->pivot, first), solve(J->A, J->pivot, second);
    increments(o, &J->turn, first, eq, unused), increments(o, &J->turn, second, unused, ev);
    for (int i = 0; i < SIZE; i++) first[i] = second[i] = 0;
    for (int i = 0; i < 3; i++) { /* v once more, with what the error of q makes of it, and the levels of dense output */
        const double rise = q1[i] - s->q[i], part = GAUSS;
        first[i] = ev[i] / in_v, at_q[i] = q1[i] + eq[i];
        inside_q[i] = s->q[i] + part * (h * s->v[i] + part * (3 * rise - h * (2 * s->v[i] + v1[i])
                      + part * (h * (s->v[i] + v1[i]) - 2 * rise)));
        inside_v[i] = s->v[i] + part * (2 * (3 * rise / h - 2 * s->v[i] - v1[i]) + 3 * part * (s->v[i] + v1[i] - 2 * rise / h));
    }
    levels(o, at_q, v1, g);
    first[5] = -o->V * g[2], first[6] = -o->V * g[3];
    levels(o, inside_q, inside_v, g);
    for (int i = 0; i < 2; i++) second[3 + i] = o->P * g[i], second[5 + i] = o->V * g[2 + i];
    solve(J->A, J->pivot, first), solve(J->A, J->pivot, second);
    increments(o, &J->turn, first, unused, ev), increments(o, &J->turn, second, at_q, at_v);
    return fmax(size_of(eq, ev, weights) / sqrt(tau), size_of(at_q, at_v, weights));
}

/* What the next step is longer than an accepted one. */
static double growth(double error, double last_error, int rejected)
{
    error = fmax(error, LEAST);
    const double plain = cbrt(TARGET / error);
    double factor = plain;
    if (last_error >= 0) factor = pow(TARGET / error, 0.7 / 3) * pow(fmax(last_error, LEAST) / TARGET, 0.4 / 3);
    if (rejected) return fmin(1, factor);
    return KEEP_LOW <= plain && plain <= KEEP_HIGH ? 1 : fmin(fmax(factor, SHRINK), GROWTH);
}

/* Steps from s (in place) to `stop`; counts: accepted, rejected, iterations.  Returns 1, or 0 where Newton fails. */
int pendulum_controlled(const Pendulum *p, double alpha, double stop, double rtol, const double *atol, State *s, long *counts)
{
    double x[SIZE] = {s->a[0], s->a[1], s->a[2], s->lam[0], s->lam[1], s->lam[0], s->lam[1]};
    double q_size = larger(0, s->q, 3), v_size = larger(0, s->v, 3);
    Matrix J;
    while (s->t < stop) {
        double h = s->h_next, f[3] = {0, -p->g, 0}, q1[3], v1[3], a0[3], end[3], size = 0, t1;
        const Step here = step_of(p, alpha, h);
        f[2] = -here.damper * s->v[2] - here.spring * (s->q[2] - REST);
        for (int rejected = 0;; rejected++) {
            const double left = stop - s->t, asked = h;
            if (h >= left * (1 - 1e-9)) h = left, t1 = stop;
            else h = 2 * h > left ? left / 2 : h, t1 = s->t + h;
            const Step o = step_of(p, alpha, h);
            for (int i = 0; i < 3; i++) a0[i] = f[i] + h / s->h * (s->a[i] - f[i]);
            const double typical_q = fmax(q_size, h * v_size);
            const int taken = newton(&o, alpha, s, f, a0, x, q1, v1, typical_q, v_size, &J);
            if (taken < 0) return 0;
            counts[2] += taken;
            size = estimate(&o, alpha, s, a0, x, q1, v1, rtol, atol, larger(q_size, q1, 3), larger(v_size, v1, 3), &J, end);
            if (size <= 1) {
                const double next = h * growth(size, s->error, rejected > 0);
                s->h_next = h < asked ? fmax(next, asked) : next;
                break;
            }
            counts[1]++;
            h *= rejected ? SHRINK : fmax(SHRINK, cbrt(TARGET / size));
        }
        counts[0]++;
        s->t = t1, s->h = s->last = h, s->error = size;
        for (int i = 0; i < 3; i++) {
            s->q[i] = q1[i], s->v[i] = v1[i], s->a[i] = x[i];
            s->earlier[i] = s->acceleration[i], s->acceleration[i] = end[i];
        }
        s->lam[0] = x[5], s->lam[1] = x[6];
        q_size = larger(q_size, q1, 3), v_size = larger(v_size, v1, 3);
    }
    return 1;
}
