/* Gaussian elimination with partial pivoting, size fixed at compile time: SIZE unknowns. */
#include <math.h>

/* Solve A x = b in place: A is destroyed, b becomes x.  Returns 0 where a pivot vanishes. */
static inline int eliminate(double A[SIZE][SIZE], double b[SIZE])
{
    for (int k = 0; k < SIZE; k++) {
        int best = k;
        for (int i = k + 1; i < SIZE; i++)
            if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
        if (A[best][k] == 0.0) return 0;
        if (best != k) {
            for (int j = k; j < SIZE; j++) {
                double kept = A[k][j];
                A[k][j] = A[best][j];
                A[best][j] = kept;
            }
            double kept = b[k];
            b[k] = b[best];
            b[best] = kept;
        }
        double inverse = 1.0 / A[k][k];
        for (int i = k + 1; i < SIZE; i++) {
            double factor = A[i][k] * inverse;
            if (factor == 0.0) continue; /* many entries are zero: cheaper than the row */
            for (int j = k + 1; j < SIZE; j++) A[i][j] -= factor * A[k][j];
            b[i] -= factor * b[k];
        }
        A[k][k] = inverse;
    }
    for (int i = SIZE - 1; i >= 0; i--) {
        double sum = b[i];
        for (int j = i + 1; j < SIZE; j++) sum -= A[i][j] * b[j];
        b[i] = sum * A[i][i];
    }
    return 1;
}

/* The same in two parts: A becomes its factors, rows exchanged as `pivot` tells.  Returns 0 where a pivot vanishes. */
static inline int factorise(double A[SIZE][SIZE], int pivot[SIZE])
{
    for (int k = 0; k < SIZE; k++) {
        int best = k;
        for (int i = k + 1; i < SIZE; i++)
            if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
        if (A[best][k] == 0.0) return 0;
        pivot[k] = best;
        if (best != k)
            for (int j = 0; j < SIZE; j++) {
                double kept = A[k][j];
                A[k][j] = A[best][j];
                A[best][j] = kept;
            }
        double inverse = 1.0 / A[k][k];
        for (int i = k + 1; i < SIZE; i++) {
            double factor = A[i][k] *= inverse;
            if (factor == 0.0) continue;
            for (int j = k + 1; j < SIZE; j++) A[i][j] -= factor * A[k][j];
        }
        A[k][k] = inverse;
    }
    return 1;
}

static inline void solve(const double A[SIZE][SIZE], const int pivot[SIZE], double b[SIZE])
{
    for (int k = 0; k < SIZE; k++) {
        double kept = b[pivot[k]];
        b[pivot[k]] = b[k];
        b[k] = kept;
    }
    for (int i = 1; i < SIZE; i++)
        for (int j = 0; j < i; j++) b[i] -= A[i][j] * b[j];
    for (int i = SIZE - 1; i >= 0; i--) {
        for (int j = i + 1; j < SIZE; j++) b[i] -= A[i][j] * b[j];
        b[i] *= A[i][i];
    }
}

/* (H15): whether increments of q1 and v1, over typical sizes, or what contraction leaves of them, are roundoff. */
static int converged(double moved, double last)
{
    double rate = fmax(moved / last, 1e-3);
    return moved <= 1e-13 || (last < INFINITY && rate < 1.0 && moved * rate / (1.0 - rate) <= 1e-15);
}

/* The largest of size and |x|; NaN where one of them is, which fmax alone would pass over. */
static double larger(double size, const double *x, int n)
{
    for (int i = 0; i < n; i++)
        if (fabs(x[i]) > size || x[i] != x[i]) size = fabs(x[i]);
    return size;
}
