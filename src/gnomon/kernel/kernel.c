/* The loops in which a camera-IMU calibration spends its time: rows of the inertial error terms, sums over the corners
   of an exposure, and what is added to the normal equations; rotations from rates; running sums for Allan variances; and
   the fit of corners to the pixels around them, and of a board to its corners; rows of a PNG, and of a table. Each does what the NumPy code beside its
   caller does (estimate/camera_imu/terms, estimate/multiposition, estimate/allan, detect), to rounding; equations and
   names are explained there. C99, no library but the mathematical one. Matrices are 3 x 3, row by row. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#if defined(__GNUC__) && defined(__x86_64__)
#include <immintrin.h>
#endif

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* The same source for processors with and without AVX2, chosen when it is loaded, by what the processor can do:
   "arch=haswell" would be chosen on a Haswell alone. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#if __GNUC__ >= 12
#define CLONES __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define CLONES __attribute__((target_clones("avx2", "default")))
#endif
#else
#define CLONES
#endif

/* So that the clones of a function are made of it, too. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

#define INTERFACE 11 /* changes whenever the arguments of a function do */
#define ORDER 16    /* of a spline, at most */
#define WIDTH 64    /* columns of a corner, at most */

EXPORT int64_t gnomon_interface(void) { return INTERFACE; }

/* small matrices */

static inline void multiply(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static inline void multiply_add(const double *a, const double *b, double *out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] += a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static inline void apply(const double *a, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[3 * i] * v[0] + a[3 * i + 1] * v[1] + a[3 * i + 2] * v[2];
}

static inline void apply_add(const double *a, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] += a[3 * i] * v[0] + a[3 * i + 1] * v[1] + a[3 * i + 2] * v[2];
}

static inline void apply_transposed(const double *a, const double *v, double *out) {
    for (int i = 0; i < 3; i++) out[i] = a[i] * v[0] + a[3 + i] * v[1] + a[6 + i] * v[2];
}

static inline void transpose(const double *a, double *out) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) out[3 * i + j] = a[3 * j + i];
}

static inline void skew(const double *v, double *out) {
    out[0] = out[4] = out[8] = 0.0;
    out[1] = -v[2], out[2] = v[1], out[3] = v[2], out[5] = -v[0], out[6] = -v[1], out[7] = v[0];
}

static inline double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static inline void cross(const double *a, const double *b, double *out) {
    out[0] = a[1] * b[2] - a[2] * b[1], out[1] = a[2] * b[0] - a[0] * b[2], out[2] = a[0] * b[1] - a[1] * b[0];
}

/* products of rows */

#define TOGETHER 8 /* columns that are summed up at once */

static inline int64_t padded_width(int64_t w) { return (w + TOGETHER - 1) / TOGETHER * TOGETHER; }

/* Adds the products of the columns of rows (n, stride) to the upper triangle of sums (w, stride), w up to a multiple of
   four, stride of eight; left of the diagonal they mean nothing. */
static void add_gram_plain(int64_t n, int64_t w, int64_t stride, const double *rows, double *sums) {
    for (int64_t i = 0; i < w; i += 4)
        for (int64_t j = i & ~(int64_t)(TOGETHER - 1); j < stride; j += TOGETHER) {
            double total[4][TOGETHER] = {{0}};
            for (int64_t k = 0; k < n; k++) {
                const double *a = rows + k * stride + i, *b = rows + k * stride + j;
                for (int r = 0; r < 4; r++)
                    for (int c = 0; c < TOGETHER; c++) total[r][c] += a[r] * b[c];
            }
            for (int r = 0; r < 4; r++)
                for (int c = 0; c < TOGETHER; c++) sums[(i + r) * stride + j + c] += total[r][c];
        }
}

#if defined(__GNUC__) && defined(__x86_64__)
__attribute__((target("avx2,fma"))) static void add_gram_wide(int64_t n, int64_t w, int64_t stride, const double *rows,
                                                              double *sums) {
    for (int64_t i = 0; i < w; i += 4)
        for (int64_t j = i & ~(int64_t)(TOGETHER - 1); j < stride; j += TOGETHER) {
            __m256d total[4][2];
            for (int r = 0; r < 4; r++) total[r][0] = total[r][1] = _mm256_setzero_pd();
            for (int64_t k = 0; k < n; k++) {
                const double *a = rows + k * stride + i, *b = rows + k * stride + j;
                const __m256d left = _mm256_loadu_pd(b), right = _mm256_loadu_pd(b + 4);
                for (int r = 0; r < 4; r++) {
                    const __m256d by = _mm256_broadcast_sd(a + r);
                    total[r][0] = _mm256_fmadd_pd(by, left, total[r][0]);
                    total[r][1] = _mm256_fmadd_pd(by, right, total[r][1]);
                }
            }
            for (int r = 0; r < 4; r++) {
                double *to = sums + (i + r) * stride + j;
                _mm256_storeu_pd(to, _mm256_add_pd(_mm256_loadu_pd(to), total[r][0]));
                _mm256_storeu_pd(to + 4, _mm256_add_pd(_mm256_loadu_pd(to + 4), total[r][1]));
            }
        }
}
#endif

static void add_gram(int64_t n, int64_t w, int64_t stride, const double *rows, double *sums) {
#if defined(__GNUC__) && defined(__x86_64__)
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
        add_gram_wide(n, w, stride, rows, sums);
        return;
    }
#endif
    add_gram_plain(n, w, stride, rows, sums);
}

/* rotation vectors, as geometry/rotations.py has them */

typedef struct {
    double a, b, c, b_slope, c_slope, b_bend, c_bend;
} Coefficients;

/* sum over n >= first of (-1)^n scale(n) x^(n - first) / (2 n + odd)!, scale 1, 2 n or 4 n (n - 1) */
static double series(double x, int first, int terms, int odd, int kind) {
    double total = 0.0, term = 1.0;
    for (int k = 2; k <= 2 * first + odd; k++) term /= k;
    if (first % 2) term = -term;
    for (int n = first; n < first + terms; n++) {
        total += term * (kind == 0 ? 1.0 : kind == 1 ? 2.0 * n : 4.0 * n * (n - 1.0));
        term *= -x / ((2.0 * n + odd + 1) * (2.0 * n + odd + 2));
    }
    return total;
}

static void coefficients(double x, int bends, Coefficients *f) {
    const double theta = sqrt(x), sine = sin(theta), half = sin(theta / 2), versine = 2 * half * half;
    if (x < 0.25) {
        f->a = series(x, 0, 9, 1, 0), f->b = series(x, 0, 9, 2, 0), f->c = series(x, 0, 9, 3, 0);
        f->b_slope = series(x, 1, 9, 2, 1), f->c_slope = series(x, 1, 9, 3, 1);
    } else {
        f->a = sine / theta, f->b = versine / x, f->c = (theta - sine) / (x * theta);
        f->b_slope = (theta * sine - 2 * versine) / (x * x);
        f->c_slope = (theta * versine - 3 * (theta - sine)) / (x * x * theta);
    }
    if (!bends) return;
    if (x < 2.0) {
        f->b_bend = series(x, 2, 11, 2, 2), f->c_bend = series(x, 2, 11, 3, 2);
    } else {
        f->b_bend = (x * (1 - versine) - 5 * theta * sine + 8 * versine) / (x * x * x);
        f->c_bend = (x * sine - 7 * theta * versine + 15 * (theta - sine)) / (x * x * x * theta);
    }
}

/* derivative of Jr(phi) v by phi */
static void rate_by_phi(const Coefficients *f, const double *phi, const double *v, double *out) {
    double once[3], twice[3];
    cross(phi, v, once), cross(phi, once, twice);
    skew(v, out);
    const double along = f->c * dot(phi, v);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] = f->b * out[3 * i + j] + (f->c_slope * twice[i] - f->b_slope * once[i]) * phi[j] +
                             f->c * (phi[i] * v[j] - 2 * v[i] * phi[j]) + (i == j ? along : 0.0);
}

/* derivative by phi of (d(Jr(phi) v) / d phi) v, added */
static void bent_add(const Coefficients *f, double x, const double *phi, const double *v, double *out) {
    double once[3], twice[3], turn[9];
    const double along = dot(phi, v), length = dot(v, v);
    cross(phi, v, once), skew(v, turn);
    for (int i = 0; i < 3; i++) twice[i] = phi[i] * along - x * v[i];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            out[3 * i + j] +=
                f->b_slope * (along * turn[3 * i + j] - once[i] * v[j]) - f->b_bend * along * once[i] * phi[j] +
                f->c_bend * along * twice[i] * phi[j] +
                f->c_slope * (twice[i] * v[j] + (phi[i] * length - v[i] * along) * phi[j]) +
                f->c_slope * along * ((i == j ? along : 0.0) + phi[i] * v[j] - 2 * v[i] * phi[j]) +
                f->c * ((i == j ? length : 0.0) - v[i] * v[j]);
}

/* inertial rows */

/* An IMU, and gravity: fields of doubles in this order. */
typedef struct {
    double K_g[9], B[9], C_bg[9], S_g[3], M_g[9], K_a[9], S_a[3], M_a[9], R_imu_body[9];
    double origin[9], places[9], places_by_arms[54], gravity[3], by_direction[6], by_magnitude[3];
} Imu;

/* First column of each block in the rows, or -1. */
typedef struct {
    int64_t S_g, M_g, q_bg, B_g, S_a, M_a, lever_arms, rotation, translation, time_shift, accelerometer_shift;
    int64_t direction, magnitude, side;
} Blocks;

/* Derivatives by the rotation vector, its rate and acceleration, and the acceleration of the body. */
typedef struct {
    double phi[9], rate[9], phi_acceleration[9], acceleration[9];
} By;

typedef struct {
    double R[9], J[9], W[9], omega[3], alpha[3], force[3], A[9], alpha_by_phi[9], alpha_by_rate[9];
    double phi[3], rate[3], acceleration[3], jerk[6], bias_rate[6];
} Moment;

/* e_k' A r_k: its derivatives by omega and alpha */
static void along_places(const double *omega, const double *places, double *by_omega, double *by_alpha) {
    for (int k = 0; k < 3; k++) {
        const double *r = places + 3 * k, e[3] = {k == 0, k == 1, k == 2};
        const double along = dot(omega, r);
        for (int m = 0; m < 3; m++)
            by_omega[3 * k + m] = (k == m ? along : 0.0) + omega[k] * r[m] - 2 * r[k] * omega[m];
        cross(r, e, by_alpha + 3 * k);
    }
}

static int any(const double *values, int count) {
    for (int i = 0; i < count; i++)
        if (values[i] != 0.0) return 1;
    return 0;
}

/* the specific force felt at places, and its derivatives */
static void felt_at(const Moment *at, const double *places, double *felt, By *by) {
    double turn[9];
    skew(at->force, turn);
    multiply(turn, at->J, by->phi);
    transpose(at->R, by->acceleration);
    memset(by->rate, 0, sizeof by->rate);
    memset(by->phi_acceleration, 0, sizeof by->phi_acceleration);
    memcpy(felt, at->force, 3 * sizeof(double));
    if (!any(places, 9)) return;
    double by_omega[9], by_alpha[9];
    along_places(at->omega, places, by_omega, by_alpha);
    for (int k = 0; k < 3; k++) felt[k] += dot(at->A + 3 * k, places + 3 * k);
    multiply_add(by_omega, at->W, by->phi), multiply_add(by_alpha, at->alpha_by_phi, by->phi);
    multiply_add(by_omega, at->J, by->rate), multiply_add(by_alpha, at->alpha_by_rate, by->rate);
    multiply(by_alpha, at->J, by->phi_acceleration);
}

/* derivative of the felt force by a small turn of omega, alpha and f against the places */
static void by_turn(const Moment *at, const double *places, double *out) {
    double by_omega[9], by_alpha[9], turn[9];
    along_places(at->omega, places, by_omega, by_alpha);
    skew(at->force, out);
    skew(at->omega, turn), multiply_add(by_omega, turn, out);
    skew(at->alpha, turn), multiply_add(by_alpha, turn, out);
    for (int i = 0; i < 9; i++) out[i] = -out[i];
}

static void by_time(const Moment *at, const By *by, int kind, double *out) {
    memcpy(out, at->bias_rate + 3 * kind, 3 * sizeof(double));
    apply_add(by->phi, at->rate, out), apply_add(by->rate, at->acceleration, out);
    apply_add(by->phi_acceleration, at->jerk, out), apply_add(by->acceleration, at->jerk + 3, out);
}

/* a block (3, k) of derivatives into the rows, if it has columns */
static void put(double *rows, int64_t width, int64_t column, int k, const double *block, double weight) {
    if (column < 0) return;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < k; j++) rows[i * width + column + j] = weight * block[i * k + j];
}

static void put_gravity(double *rows, int64_t width, const Imu *imu, const Blocks *blocks, const By *by, double weight) {
    double direction[6], magnitude[3];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 2; j++)
            direction[2 * i + j] = by->acceleration[3 * i] * imu->by_direction[j] +
                                   by->acceleration[3 * i + 1] * imu->by_direction[2 + j] +
                                   by->acceleration[3 * i + 2] * imu->by_direction[4 + j];
    apply(by->acceleration, imu->by_magnitude, magnitude);
    put(rows, width, blocks->direction, 2, direction, weight);
    put(rows, width, blocks->magnitude, 1, magnitude, weight);
}

/* pose, bias and residual */
static void put_local(double *rows, int64_t width, int64_t order, const double *basis, double u, const Blocks *blocks,
                      int kind, const By *by, const double *residual, double weight) {
    for (int i = 0; i < 3; i++) {
        double *row = rows + i * width;
        for (int64_t a = 0; a < order; a++) {
            const double value = weight * basis[a], rate = weight * basis[order + a];
            const double acceleration = weight * basis[2 * order + a];
            for (int j = 0; j < 3; j++) {
                row[6 * a + j] = value * by->phi[3 * i + j] + rate * by->rate[3 * i + j] +
                                 acceleration * by->phi_acceleration[3 * i + j];
                row[6 * a + 3 + j] = acceleration * by->acceleration[3 * i + j];
            }
        }
        row[6 * order + 3 * kind + i] = (1 - u) * weight;
        row[6 * order + 6 + 3 * kind + i] = u * weight;
        row[blocks->side] = -residual[i] * weight;
    }
}

static void put_gyroscope(double *rows, int64_t width, int64_t order, const double *basis, double u, const Imu *imu,
                          const Blocks *blocks, const Moment *at, const double *bias, const double *read, double weight,
                          double *residual) {
    By by, felt_by;
    double force[3], turned[3], scaled[3], matrix[27], turn[9];
    const int pulled = blocks->B_g >= 0 || any(imu->B, 9);
    memset(&by, 0, sizeof by);
    multiply(imu->K_g, at->W, by.phi), multiply(imu->K_g, at->J, by.rate);
    felt_at(at, imu->origin, force, &felt_by);
    if (pulled) {
        multiply_add(imu->B, felt_by.phi, by.phi), multiply_add(imu->B, felt_by.rate, by.rate);
        multiply(imu->B, felt_by.phi_acceleration, by.phi_acceleration);
        multiply(imu->B, felt_by.acceleration, by.acceleration);
    }
    apply(imu->K_g, at->omega, residual);
    apply_add(imu->B, force, residual);
    for (int i = 0; i < 3; i++) residual[i] += bias[i] - read[i];
    put_local(rows, width, order, basis, u, blocks, 0, &by, residual, weight);
    apply_transposed(imu->C_bg, at->omega, turned), apply(imu->M_g, turned, scaled);
    const double S_g[9] = {scaled[0], 0, 0, 0, scaled[1], 0, 0, 0, scaled[2]};
    const double M_g[9] = {0, 0, 0, imu->S_g[1] * turned[0], 0, 0, 0, imu->S_g[2] * turned[0], imu->S_g[2] * turned[1]};
    put(rows, width, blocks->S_g, 3, S_g, weight), put(rows, width, blocks->M_g, 3, M_g, weight);
    if (blocks->q_bg >= 0) {
        skew(turned, turn), multiply(imu->M_g, turn, matrix);
        for (int i = 0; i < 9; i++) matrix[i] *= imu->S_g[i / 3];
        put(rows, width, blocks->q_bg, 3, matrix, weight);
    }
    if (blocks->B_g >= 0) {
        memset(matrix, 0, sizeof matrix);
        for (int i = 0; i < 3; i++) memcpy(matrix + 12 * i, force, sizeof force);
        put(rows, width, blocks->B_g, 9, matrix, weight);
    }
    if (blocks->rotation >= 0) {
        double of_body[9], by_omega[9];
        by_turn(at, imu->origin, turn), multiply(imu->B, turn, of_body);
        skew(at->omega, turn), multiply(imu->K_g, turn, by_omega);
        for (int i = 0; i < 9; i++) of_body[i] -= by_omega[i];
        multiply(of_body, imu->R_imu_body, matrix), put(rows, width, blocks->rotation, 3, matrix, weight);
    }
    if (blocks->translation >= 0) {
        multiply(imu->B, at->A, matrix), put(rows, width, blocks->translation, 3, matrix, -weight);
    }
    if (blocks->time_shift >= 0) by_time(at, &by, 0, matrix), put(rows, width, blocks->time_shift, 1, matrix, weight);
    if (pulled) put_gravity(rows, width, imu, blocks, &by, weight);
}

static void put_accelerometer(double *rows, int64_t width, int64_t order, const double *basis, double u, const Imu *imu,
                              const Blocks *blocks, const Moment *at, const double *bias, const double *read,
                              double weight, double *residual) {
    By by, felt_by;
    double felt[3], scaled[3], matrix[18], turn[9];
    felt_at(at, imu->places, felt, &felt_by);
    multiply(imu->K_a, felt_by.phi, by.phi), multiply(imu->K_a, felt_by.rate, by.rate);
    multiply(imu->K_a, felt_by.phi_acceleration, by.phi_acceleration);
    multiply(imu->K_a, felt_by.acceleration, by.acceleration);
    apply(imu->K_a, felt, residual);
    for (int i = 0; i < 3; i++) residual[i] += bias[i] - read[i];
    put_local(rows, width, order, basis, u, blocks, 1, &by, residual, weight);
    apply(imu->M_a, felt, scaled);
    const double S_a[9] = {scaled[0], 0, 0, 0, scaled[1], 0, 0, 0, scaled[2]};
    const double M_a[9] = {0, 0, 0, imu->S_a[1] * felt[0], 0, 0, 0, imu->S_a[2] * felt[0], imu->S_a[2] * felt[1]};
    put(rows, width, blocks->S_a, 3, S_a, weight), put(rows, width, blocks->M_a, 3, M_a, weight);
    if (blocks->lever_arms >= 0) {
        double moved[18];
        for (int k = 0; k < 3; k++)
            for (int m = 0; m < 6; m++) {
                const double *by_arm = imu->places_by_arms + 18 * k + m, *A = at->A + 3 * k;
                moved[6 * k + m] = A[0] * by_arm[0] + A[1] * by_arm[6] + A[2] * by_arm[12];
            }
        for (int i = 0; i < 3; i++)
            for (int m = 0; m < 6; m++)
                matrix[6 * i + m] = imu->K_a[3 * i] * moved[m] + imu->K_a[3 * i + 1] * moved[6 + m] +
                                    imu->K_a[3 * i + 2] * moved[12 + m];
        put(rows, width, blocks->lever_arms, 6, matrix, weight);
    }
    if (blocks->rotation >= 0) {
        double of_body[9];
        by_turn(at, imu->places, turn), multiply(imu->K_a, turn, of_body);
        multiply(of_body, imu->R_imu_body, matrix), put(rows, width, blocks->rotation, 3, matrix, weight);
    }
    if (blocks->translation >= 0) {
        multiply(imu->K_a, at->A, matrix), put(rows, width, blocks->translation, 3, matrix, -weight);
    }
    by_time(at, &by, 1, matrix);
    put(rows, width, blocks->time_shift, 1, matrix, weight);
    put(rows, width, blocks->accelerometer_shift, 1, matrix, weight);
    put_gravity(rows, width, imu, blocks, &by, weight);
}

/* where the body is at an instant */
static void move(const double *controls, int64_t scalars, int64_t order, const double *basis, const double *reference,
                 const Imu *imu, Moment *at) {
    double p[12] = {0}, rotation[9], turn[9], squared;
    double phi_terms[9], J[9], W[9];
    Coefficients f;
    memset(at->jerk, 0, sizeof at->jerk);
    for (int64_t a = 0; a < order; a++) {
        const double *control = controls + a * scalars;
        for (int i = 0; i < 3; i++) {
            p[i] += basis[a] * control[i];
            p[3 + i] += basis[order + a] * control[i];
            p[6 + i] += basis[2 * order + a] * control[i];
            p[9 + i] += basis[2 * order + a] * control[3 + i];
        }
        for (int i = 0; i < 6; i++) at->jerk[i] += basis[3 * order + a] * control[i];
    }
    memcpy(at->phi, p, 24), memcpy(at->rate, p + 3, 24), memcpy(at->acceleration, p + 6, 24);
    squared = dot(p, p);
    coefficients(squared, 1, &f);
    skew(p, turn);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const double unit = i == j, twice = p[i] * p[j] - (i == j ? squared : 0.0);
            rotation[3 * i + j] = unit + f.a * turn[3 * i + j] + f.b * twice;
            J[3 * i + j] = unit - f.b * turn[3 * i + j] + f.c * twice;
        }
    rate_by_phi(&f, p, p + 3, W);
    rate_by_phi(&f, p, p + 6, phi_terms), bent_add(&f, squared, p, p + 3, phi_terms);
    double R[9], by_omega[9], turned[9];
    multiply(reference, rotation, R);
    transpose(imu->R_imu_body, turned), multiply(R, turned, at->R);
    multiply(imu->R_imu_body, J, at->J), multiply(imu->R_imu_body, W, at->W);
    multiply(imu->R_imu_body, phi_terms, at->alpha_by_phi);
    apply(at->J, p + 3, at->omega);
    apply(at->W, p + 3, at->alpha), apply_add(at->J, p + 6, at->alpha);
    skew(at->omega, turn), multiply(turn, at->J, by_omega);
    for (int i = 0; i < 9; i++) at->alpha_by_rate[i] = 2 * at->W[i] - by_omega[i];
    double acceleration[3];
    for (int i = 0; i < 3; i++) acceleration[i] = p[9 + i] - imu->gravity[i];
    apply_transposed(at->R, acceleration, at->force);
    skew(at->alpha, at->A);
    squared = dot(at->omega, at->omega);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) at->A[3 * i + j] += at->omega[i] * at->omega[j] - (i == j ? squared : 0.0);
}

/* Readings of an IMU on a trajectory.

   bases (4, order, order) polynomials, by powers of u, of the basis functions and three derivatives by time
   controls (., scalars), the biases of this IMU from column `bias_at` on, those of a span's knots `offset` further
   read and weight: (n, 3) and (n,) of the gyroscope, then of the accelerometer; null where there is none
   sign (n, height) of the probes behind the residual, or null */
typedef struct {
    int64_t order;
    const int64_t *first;
    const double *u;
    const int64_t *segment;
    const double *references, *bases, *controls;
    int64_t scalars, bias_at, offset;
    double spacing;
    const Imu *imu;
    const Blocks *blocks;
    const double *read_g, *weight_g, *read_a, *weight_a, *sign;
} Readings;

/* The whitened rows (height, stride) of a reading, zero so far; returns the height, `chi2` grows by the squares of the
   residuals of both triads. */
static int64_t fill_rows(const Readings *of, int64_t k, int64_t stride, double *rows, double *chi2) {
    const int64_t order = of->order, height = (of->read_g ? 3 : 0) + (of->read_a ? 3 : 0);
    double basis[4 * ORDER], bias[6], residual[3], *row = rows;
    const double u = of->u[k];
    Moment at;
    for (int64_t d = 0; d < 4; d++)
        for (int64_t a = 0; a < order; a++) {
            double total = 0.0;
            for (int64_t power = order - 1; power >= 0; power--)
                total = total * u + of->bases[(d * order + power) * order + a];
            basis[d * order + a] = total;
        }
    move(of->controls + of->first[k] * of->scalars, of->scalars, order, basis, of->references + 9 * of->segment[k], of->imu, &at);
    const double *knot = of->controls + (of->first[k] + of->offset) * of->scalars + of->bias_at;
    for (int i = 0; i < 6; i++) {
        bias[i] = knot[i] * (1 - u) + knot[of->scalars + i] * u;
        at.bias_rate[i] = (knot[of->scalars + i] - knot[i]) / of->spacing;
    }
    for (int kind = 0; kind < 2; kind++) {
        const double *read = kind ? of->read_a : of->read_g, *weights = kind ? of->weight_a : of->weight_g;
        if (!read) continue;
        (kind ? put_accelerometer : put_gyroscope)(row, stride, order, basis, u, of->imu, of->blocks, &at, bias + 3 * kind,
                                                   read + 3 * k, weights[k], residual);
        chi2[kind] += dot(residual, residual) * weights[k] * weights[k];
        for (int i = 0; of->sign && i < 3; i++)
            row[i * stride + of->blocks->side + 1 + kind] = of->sign[height * k + (row - rows) / stride + i] * (weights[k] > 0);
        row += 3 * stride;
    }
    return height;
}

/* Rows (n, height, width) of readings. */
EXPORT void gnomon_inertial_rows(int64_t n, const Readings *readings, int64_t width, double *rows, double *chi2) {
    const int64_t height = (readings->read_g ? 3 : 0) + (readings->read_a ? 3 : 0);
    memset(rows, 0, (size_t)(n * height * width) * sizeof(double));
    for (int64_t k = 0; k < n; k++) rows += width * fill_rows(readings, k, width, rows, chi2);
}

/* normal equations */

/* Where the normal equations are; see `_add_spans` of the assembly.

   band: (n, 6, order, 6) of pose by pose, pose by bias, bias by pose, bias by bias; the last three null without biases
   tail (n, scalars, length), `bias_at` the first scalar of the biases, columns (w - b) where in it the last ones belong
   offset of a span's bias knots from its first control point */
typedef struct {
    int64_t order, offset, scalars, length, bias_at;
    double *pose_pose, *pose_bias, *bias_pose, *bias_bias, *tail;
    const int64_t *columns;
} Band;

/* Adds the products (b, stride) of the rows of a span, b of w columns of pose and biases, of which only those right of
   the diagonal mean something. */
INLINE void add_span(const Band *to, int64_t w, int64_t stride, const double *product, int64_t first) {
    const int64_t order = to->order, pose = 6 * order, b = pose + (to->pose_bias ? 12 : 0), block = 36 * order;
    for (int64_t row = 0; row < b; row++) {
        const double *values = product + row * stride, *above = product + row;
        const int64_t which = row / 6, i = row % 6, knot = which - order;
        const int64_t control = first + (row < pose ? which : to->offset + knot);
        double *end = to->tail + (control * to->scalars + (row < pose ? i : to->bias_at + i)) * to->length;
        for (int64_t j = b; j < w; j++) end[to->columns[j - b]] += values[j];
        const int64_t start = 6 * which, last = row < pose ? pose : b;
        double *own = (row < pose ? to->pose_pose : to->bias_bias) + control * block + i * pose;
        for (int64_t j = start; j < row; j++) own[j - start] += above[j * stride];
        for (int64_t j = row; j < last; j++) own[j - start] += values[j];
        for (int64_t other = 0; row < pose && to->pose_bias && other < 2; other++) {
            const double *found = values + pose + 6 * other;
            const int64_t apart = to->offset + other - which;
            if (apart >= 0) {
                double *at = to->pose_bias + control * block + i * pose + 6 * apart;
                for (int j = 0; j < 6; j++) at[j] += found[j];
            } else { /* the bias stands at the earlier control point: it has the row */
                double *at = to->bias_pose + (first + to->offset + other) * block - 6 * apart + i;
                for (int j = 0; j < 6; j++) at[j * pose] += found[j];
            }
        }
    }
}

/* Adds the products (s, b, w) of the rows of some spans. */
CLONES EXPORT void gnomon_add_spans(int64_t s, int64_t w, const double *sums, const int64_t *spans, const Band *to) {
    const int64_t b = 6 * to->order + (to->pose_bias ? 12 : 0);
    for (int64_t k = 0; k < s; k++) add_span(to, w, w, sums + k * b * w, spans[k]);
}

#define LINES 24 /* rows whose products are summed up at once */
#define INERTIAL 168 /* columns of a reading, at most */

/* Adds the products of the rows of readings (n) of w columns; those of the columns behind pose and biases with each
   other to `corner` (w - b, w - b). */
CLONES EXPORT void gnomon_inertial_sums(int64_t n, const Readings *readings, int64_t w, const Band *to, double *corner,
                                        double *chi2) {
    const int64_t stride = padded_width(w), b = 6 * to->order + 12, rest = w - b;
    double rows[LINES * INERTIAL], sums[INERTIAL * INERTIAL];
    for (int64_t k = 0; k < n;) {
        const int64_t first = readings->first[k];
        memset(sums, 0, (size_t)(stride * stride) * sizeof(double));
        while (k < n && readings->first[k] == first) {
            int64_t height = 0;
            memset(rows, 0, (size_t)(LINES * stride) * sizeof(double));
            for (; k < n && readings->first[k] == first && height + 6 <= LINES; k++)
                height += fill_rows(readings, k, stride, rows + height * stride, chi2);
            add_gram(height, w, stride, rows, sums);
        }
        add_span(to, w, stride, sums, first);
        for (int64_t i = 0; i < rest; i++)
            for (int64_t j = i; j < rest; j++) corner[i * rest + j] += sums[(b + i) * stride + b + j];
    }
    for (int64_t i = 0; i < rest; i++)
        for (int64_t j = 0; j < i; j++) corner[i * rest + j] = corner[j * rest + i];
}

/* tied equations (solve/bordered_band.py) */

/* Which super-blocks (2) have the values that a tied scalar of a control point lies between, and their weights. */
static inline void tied_weights(int64_t control, int64_t offset, int64_t per_block, int64_t blocks, int64_t *block,
                                double *weight) {
    const int64_t since = control < offset ? 0 : control - offset, last = blocks - 1, k = since / per_block;
    block[0] = k < last ? k : last, block[1] = k < last ? k + 1 : last;
    weight[1] = (double)(since % per_block) / (double)per_block, weight[0] = 1 - weight[1];
}

/* Adds products of scalars from r on of super-block a (rows) with those from c on of b, which is the same or beside it. */
INLINE void add_block(double *lower, double *chain, int64_t s, int64_t t, int64_t a, int64_t r, int64_t b, int64_t c,
                      int64_t rows, int64_t columns, double by, const double *values, int64_t down, int64_t along) {
    double *to = a == b ? lower + (a * s + r) * s + c : a < b ? chain + (a * (s + t) + c) * s + r : chain + (b * (s + t) + r) * s + c;
    const int64_t by_row = a < b ? 1 : s, by_column = a < b ? s : 1;
    for (int64_t i = 0; i < rows; i++)
        for (int64_t k = 0; k < columns; k++) to[i * by_row + k * by_column] += by * values[i * down + k * along];
}

/* Writes T' N T to the super-blocks on the diagonal (b, s, s), right of it, and those after them and T' tail, transposed
   (b, s + t, s); both zero so far.

   band: (groups, groups) of pointers to (n, size, order, size); tail (n, d, t) */
EXPORT void gnomon_gather_tied(int64_t n, int64_t per_block, int64_t order, int64_t offset, int64_t groups,
                               const int64_t *sizes, const double *const *band, const double *tail, int64_t t,
                               double *lower, double *chain) {
    const int64_t d = sizes[0], own = per_block * d, blocks = (n + per_block - 1) / per_block;
    int64_t s = own, all = d;
    for (int64_t g = 1; g < groups; g++) s += sizes[g], all += sizes[g];
    for (int64_t i = 0; i < n; i++) {
        const int64_t block = i / per_block, row = i % per_block * d;
        double *beside = chain + (block * (s + t) + s) * s;
        for (int64_t r = 0; r < d; r++)
            for (int64_t k = 0; k < t; k++) beside[k * s + row + r] = tail[(i * all + r) * t + k];
        for (int64_t j = 0; j < order && i + j < n; j++)
            add_block(lower, chain, s, t, block, row, (i + j) / per_block, (i + j) % per_block * d, d, d, 1.0,
                      band[0] + i * d * order * d + j * d, order * d, 1);
        int64_t at = own, first = d, near[2], then[2];
        double weight[2], after[2];
        tied_weights(i, offset, per_block, blocks, near, weight);
        for (int64_t g = 1; g < groups; at += sizes[g], first += sizes[g], g++) {
            const int64_t size = sizes[g];
            for (int h = 0; h < 2; h++)
                for (int64_t r = 0; weight[h] != 0.0 && r < size; r++)
                    for (int64_t k = 0; k < t; k++)
                        chain[(near[h] * (s + t) + s + k) * s + at + r] += weight[h] * tail[(i * all + first + r) * t + k];
            for (int64_t j = 0; j < order && i + j < n; j++) {
                const int64_t to = (i + j) / per_block, column = (i + j) % per_block * d;
                const double *later = band[g] + i * d * order * size + j * size;
                const double *earlier = band[g * groups] + i * size * order * d + j * d;
                const double *same = band[g * groups + g] + i * size * order * size + j * size;
                tied_weights(i + j, offset, per_block, blocks, then, after);
                for (int h = 0; h < 2; h++) {
                    if (after[h] != 0.0 && llabs(then[h] - block) < 2)
                        add_block(lower, chain, s, t, block, row, then[h], at, d, size, after[h], later, order * size, 1);
                    if (weight[h] != 0.0 && llabs(near[h] - to) < 2)
                        add_block(lower, chain, s, t, to, column, near[h], at, d, size, weight[h], earlier, 1, order * d);
                }
                for (int h = 0; j < 2 && h < 4; h++) { /* of a control point with itself both triangles are there */
                    const int64_t a = near[h / 2], b = then[h % 2];
                    const double by = weight[h / 2] * after[h % 2];
                    if (by == 0.0 || (!j && a > b)) continue;
                    add_block(lower, chain, s, t, a, at, b, at, size, size, by, same, order * size, 1);
                    if (j && a == b) add_block(lower, chain, s, t, a, at, b, at, size, size, by, same, 1, order * size);
                }
            }
        }
    }
    for (int64_t row = n * d - (blocks - 1) * own; row < own; row++) lower[((blocks - 1) * s + row) * s + row] = 1.0;
}

/* corners */

/* A lens, fields of doubles in this order; models by their place in the lists of models/lens_names.py. */
typedef struct {
    double projection, distortion, limit, shape[2], fu, fv, pu, pv, coeffs[5];
} Lens;

enum { PINHOLE, OMNI, EUCM, DS };
enum { NONE, RADTAN, RADTAN5, EQUIDISTANT, FOV };

#define NEAREST 1e-100
#define FARTHEST 1e100
#define PARAMETERS 11 /* of a lens, at most */

/* A point in the plane behind the projection or distortion, and its derivatives; see models/distortions.py. */
typedef struct {
    double x, y, xx, xy, yy, by_coeffs[5][2];
} Bent;

/* A = atan(r) / r and dA/ds, of s = r^2 */
INLINE void arctan_over_x(double s, double *ratio, double *slope) {
    if (s < 0.01) {
        double a = 0.0, b = 0.0;
        for (int n = 9; n >= 0; n--) b = b * s + a, a = a * s + (n % 2 ? -1.0 : 1.0) / (2 * n + 1);
        *ratio = a, *slope = b;
    } else {
        const double r = sqrt(s);
        *ratio = atan(r) / r;
        *slope = (1 / (1 + s) - *ratio) / (2 * s);
    }
}

/* 1 + tan(h)^2 - tan(h) / h */
static double fov_excess(double half) {
    const double t = half * half, tangent = tan(half);
    const double ratio =
        half < 0.1 ? t * (1. / 3 + t * (2. / 15 + t * (17. / 315 + t * (62. / 2835 + t * (1382. / 155925 + t * 21844. / 6081075)))))
                   : tangent / half - 1;
    return tangent * tangent - ratio;
}

INLINE void bend(const Lens *lens, double mx, double my, double s, Bent *at) {
    const double *k = lens->coeffs;
    double c = 1.0, twice_slope = 0.0;
    if (lens->distortion == RADTAN || lens->distortion == RADTAN5) {
        const double k3 = lens->distortion == RADTAN5 ? k[4] : 0.0, p1 = k[2], p2 = k[3];
        const double across = 2 * mx * my, square_x = s + 2 * mx * mx, square_y = s + 2 * my * my;
        const double px = 2 * p2 * mx, py = 2 * p1 * my;
        c = 1 + s * (k[0] + s * (k[1] + s * k3)), twice_slope = 2 * k[0] + s * (4 * k[1] + s * 6 * k3);
        at->x = mx * c + p1 * across + p2 * square_x, at->y = my * c + p2 * across + p1 * square_y;
        at->xx = c + twice_slope * mx * mx + (3 * px + py), at->yy = c + twice_slope * my * my + (3 * py + px);
        at->xy = twice_slope * mx * my + 2 * p1 * mx + 2 * p2 * my;
        const double by[5][2] = {{s * mx, s * my}, {s * s * mx, s * s * my}, {across, square_y}, {square_x, across}, {s * s * s * mx, s * s * s * my}};
        memcpy(at->by_coeffs, by, sizeof by);
        return;
    }
    if (lens->distortion == EQUIDISTANT) {
        double a, slope;
        arctan_over_x(s, &a, &slope);
        const double t = s * a * a, polynomial = 1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])));
        const double by_t = k[0] + t * (2 * k[1] + t * (3 * k[2] + t * 4 * k[3]));
        c = a * polynomial, twice_slope = 2 * (slope * polynomial + a * a * by_t / (1 + s));
        for (int i = 0; i < 4; i++) a *= t, at->by_coeffs[i][0] = mx * a, at->by_coeffs[i][1] = my * a;
    } else if (lens->distortion == FOV) {
        const double w = k[0], factor = 2 * tan(w / 2), square = factor * factor, tau = square * s;
        double a, slope;
        arctan_over_x(tau, &a, &slope);
        const double widening = 1 + 0.25 * square, rest = 2 * slope + 1 / (1 + tau);
        const double by_w = (fov_excess(w / 2) + tau * (factor / w * rest - widening / (1 + tau))) / w;
        c = factor / w * a, twice_slope = 2 * factor * square / w * slope;
        at->by_coeffs[0][0] = mx * by_w, at->by_coeffs[0][1] = my * by_w;
    }
    at->x = c * mx, at->y = c * my;
    at->xx = c + twice_slope * mx * mx, at->xy = twice_slope * mx * my, at->yy = c + twice_slope * my * my;
}

/* length - z of length^2 = square + z^2 */
static inline double excess(double length, double z, double square) {
    const double size = fabs(z);
    return square / (length + size) + (size - z);
}

static inline double reach(double alpha) { return alpha <= 0.5 ? alpha / (1 - alpha) : (1 - alpha) / alpha; }

/* Whether a point is imaged; where: pixel (2), its derivatives by the point (2, 3) and by the lens (2, PARAMETERS);
   see models/camera.py. */
INLINE int project(const Lens *lens, const double *point, double *pixel, double by_point[2][3],
                   double by_lens[2][PARAMETERS]) {
    const double x = point[0], y = point[1], z = point[2], square = x * x + y * y;
    double value = z, by_radius = 0.0, by_z = 1.0, by_shape[2] = {0};
    int shapes = 2, inside = z > 0;
    if (lens->projection == OMNI) {
        const double xi = lens->shape[0], rho = sqrt(square + z * z), slope = xi / rho;
        value = xi * rho + z, inside = z > -(xi <= 1 ? xi : 1 / xi) * rho;
        by_radius = slope, by_z = 1 + slope * z, by_shape[0] = rho, shapes = 1;
    } else if (lens->projection == EUCM) {
        const double alpha = lens->shape[0], beta = lens->shape[1], d = sqrt(beta * square + z * z), slope = alpha / d;
        value = alpha * d + (1 - alpha) * z, inside = z > -reach(alpha) * d;
        by_radius = slope * beta, by_z = slope * z + (1 - alpha);
        by_shape[0] = excess(d, z, beta * square), by_shape[1] = 0.5 * slope * square;
    } else if (lens->projection == DS) {
        const double xi = lens->shape[0], alpha = lens->shape[1], d_1 = sqrt(square + z * z), z_2 = xi * d_1 + z;
        const double d_2 = sqrt(square + z_2 * z_2), slope = xi / d_1, by_z_2 = alpha * z_2 / d_2 + (1 - alpha);
        const double w = reach(alpha), rest = 1 - w * w, least = -xi * rest - w * sqrt(1 - xi * xi * rest);
        value = alpha * d_2 + (1 - alpha) * z_2, inside = z > least * d_1;
        by_radius = alpha / d_2 + by_z_2 * slope, by_z = by_z_2 * (1 + slope * z);
        by_shape[0] = by_z_2 * d_1, by_shape[1] = excess(d_2, z_2, square);
    } else {
        shapes = 0;
    }
    const double inverse = 1 / value, mx = x * inverse, my = y * inverse, s = mx * mx + my * my;
    if (!(inside && value > NEAREST && value < FARTHEST && s < lens->limit * lens->limit)) return 0;
    Bent at = {0};
    bend(lens, mx, my, s, &at);
    const double focal[2] = {lens->fu, lens->fv}, bent[2] = {at.x, at.y};
    pixel[0] = lens->fu * at.x + lens->pu, pixel[1] = lens->fv * at.y + lens->pv;
    for (int i = 0; i < 2; i++) {
        const double by_x = focal[i] * (i ? at.xy : at.xx) * inverse, by_y = focal[i] * (i ? at.yy : at.xy) * inverse;
        const double shrink = by_x * mx + by_y * my, towards_axis = shrink * by_radius;
        by_point[i][0] = by_x - towards_axis * x, by_point[i][1] = by_y - towards_axis * y;
        by_point[i][2] = -shrink * by_z;
        double *to = by_lens[i];
        for (int j = 0; j < shapes; j++) to[j] = -shrink * by_shape[j];
        to += shapes;
        to[i] = bent[i], to[1 - i] = 0.0, to[2 + i] = 1.0, to[3 - i] = 0.0;
        for (int j = 0; j < 5; j++) to[4 + j] = focal[i] * at.by_coeffs[j][i];
    }
    return 1;
}

#define CORNERS 16 /* whose products are summed up at once */

/* Sums over the corners of exposures, as `corner_sums` makes them.

   start (e + 1), counted from the first corner given; R, p (e, 3, 3), (e, 3) pose of the target in the camera's frame;
   of corners: points (m, 3) on the target, pixels (m, 2) detected; own (q) parameters of the lens that have columns;
   scale of the target, which has a column if `by_scale`; shape (b, m, 3) where corners move with parameters that have one
   spread (m), sign (m, 2), number (m): null where not wanted
   out: sums (e, w, w), or (e, 2, w) where `single`; cost, square, count (e); each, weight (m), residual (m, 2); with
   `number` also by_twist (m, 6, 3), rest (w - 6, places, 3), squares (places, 3, 3), of corners that are counted */
EXPORT void gnomon_corner_sums(int64_t e, int64_t m, const int64_t *start, const double *R, const double *p,
                               const double *points, const double *pixels, const Lens *lens, const int64_t *own,
                               int64_t q, double scale, int64_t by_scale, const double *shape, int64_t bends,
                               const double *spread, const double *sign, double sigma, double huber, int64_t single,
                               double *sums, double *cost, double *square, int64_t *count, double *each, double *weight,
                               double *residual, const int64_t *number, const uint8_t *counted, int64_t places,
                               double *by_twist, double *rest, double *squares) {
    const int64_t w = 6 + q + by_scale + bends + 1 + (sign ? 1 : 0), stride = padded_width(w);
    double rows[2 * CORNERS * WIDTH], upper[WIDTH * WIDTH];
    memset(rows, 0, sizeof rows);
    for (int64_t k = 0; k < e; k++, R += 9, p += 3) {
        double total = 0.0, squared = 0.0;
        int64_t seen = 0, kept = 0;
        if (single) memset(sums + 2 * k * w, 0, (size_t)(2 * w) * sizeof(double));
        memset(upper, 0, (size_t)(stride * stride) * sizeof(double));
        for (int64_t c = start[k]; c < start[k + 1]; c++) {
            double turned[3], at[3], pixel[2], G[2][3], by_lens[2][PARAMETERS], by_offset[2][3];
            each[c] = weight[c] = 0.0, residual[2 * c] = residual[2 * c + 1] = NAN;
            if (number) memset(by_twist + 18 * c, 0, 18 * sizeof(double));
            apply(R, points + 3 * c, turned);
            for (int i = 0; i < 3; i++) at[i] = scale * turned[i] + p[i];
            if (!project(lens, at, pixel, G, by_lens)) continue;
            const double sigma_px = spread ? sigma * spread[c] : sigma;
            const double off[2] = {pixel[0] - pixels[2 * c], pixel[1] - pixels[2 * c + 1]};
            const double length = off[0] * off[0] + off[1] * off[1], distance = sqrt(length) / sigma_px;
            const double robust = distance > huber ? huber / distance : 1.0, root = sqrt(robust) / sigma_px;
            each[c] = robust < 1 ? huber * (distance - 0.5 * huber) : 0.5 * distance * distance;
            weight[c] = robust, residual[2 * c] = off[0], residual[2 * c + 1] = off[1];
            total += each[c], squared += length, seen++;
            double *columns[2] = {rows + 2 * kept * stride, rows + (2 * kept + 1) * stride};
            for (int i = 0; i < 2; i++) {
                double *column = columns[i];
                for (int j = 0; j < 3; j++) G[i][j] *= root, column[3 + j] = G[i][j];
                column[0] = G[i][2] * at[1] - G[i][1] * at[2];
                column[1] = G[i][0] * at[2] - G[i][2] * at[0];
                column[2] = G[i][1] * at[0] - G[i][0] * at[1];
                for (int64_t j = 0; j < q; j++) column[6 + j] = root * by_lens[i][own[j]];
                int64_t next = 6 + q;
                if (by_scale) column[next++] = dot(G[i], turned);
                for (int j = 0; j < 3; j++)
                    by_offset[i][j] = scale * (G[i][0] * R[j] + G[i][1] * R[3 + j] + G[i][2] * R[6 + j]);
                for (int64_t b = 0; b < bends; b++) column[next++] = dot(by_offset[i], shape + 3 * (b * m + c));
                column[next++] = root * off[i];
                if (sign) column[next] = root * sign[2 * c + i] * sigma_px;
            }
            if (number && counted[c]) {
                const int64_t place = number[c];
                for (int j = 0; j < 3; j++) {
                    const double a = by_offset[0][j], b = by_offset[1][j];
                    for (int i = 0; i < 6; i++) by_twist[18 * c + 3 * i + j] = columns[0][i] * a + columns[1][i] * b;
                    for (int64_t i = 6; i < w; i++)
                        rest[((i - 6) * places + place) * 3 + j] += columns[0][i] * a + columns[1][i] * b;
                    for (int i = 0; i < 3; i++)
                        squares[9 * place + 3 * i + j] += by_offset[0][i] * a + by_offset[1][i] * b;
                }
            }
            for (int i = 0; single && i < 2; i++) memcpy(sums + (2 * k + i) * w, columns[i], (size_t)w * sizeof(double));
            if (!single && ++kept == CORNERS) add_gram(2 * kept, w, stride, rows, upper), kept = 0;
        }
        if (kept) add_gram(2 * kept, w, stride, rows, upper);
        for (int64_t i = 0; !single && i < w; i++)
            for (int64_t j = i; j < w; j++) sums[(k * w + i) * w + j] = sums[(k * w + j) * w + i] = upper[i * stride + j];
        cost[k] = total, count[k] = seen;
        square[k] = seen ? squared / (2.0 * (double)seen) : NAN;
    }
}

/* rotations from rates (estimate/multiposition/measurements.py) */

#define REGRESSORS 7 /* of a rate: the measured one, a one, the specific force */

static inline void hamilton(const double *a, const double *b, double *out) {
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

/* The quaternion of one step of RK4n from the rates at its ends, as in geometry/rotations.py. */
static inline void rk4n_step(const double *omega0, const double *omega1, double dt, double *step) {
    double start[4] = {0.0}, end[4] = {0.0}, middle[4] = {0.0}, k2[4], k3[4], k4[4], square = 0.0;
    for (int i = 0; i < 3; i++) {
        start[i + 1] = 0.5 * dt * omega0[i], end[i + 1] = 0.5 * dt * omega1[i];
        middle[i + 1] = 0.5 * (start[i + 1] + end[i + 1]);
    }
    hamilton(start, middle, k2);
    for (int i = 0; i < 4; i++) k2[i] = 0.5 * k2[i] + middle[i];
    hamilton(k2, middle, k3);
    for (int i = 0; i < 4; i++) k3[i] = 0.5 * k3[i] + middle[i];
    hamilton(k3, end, k4);
    for (int i = 0; i < 4; i++) {
        step[i] = (start[i] + 2.0 * (k2[i] + k3[i]) + k4[i] + end[i]) / 6.0 + (i == 0);
        square += step[i] * step[i];
    }
    for (int i = 0; i < 4; i++) step[i] /= sqrt(square);
}

static inline void rotation_from_quaternion(const double *q, double *out) {
    const double w = q[0], x = q[1], y = q[2], z = q[3];
    out[0] = w * w + x * x - y * y - z * z, out[1] = 2 * (x * y - w * z), out[2] = 2 * (x * z + w * y);
    out[3] = 2 * (x * y + w * z), out[4] = w * w - x * x + y * y - z * z, out[5] = 2 * (y * z - w * x);
    out[6] = 2 * (x * z - w * y), out[7] = 2 * (y * z + w * x), out[8] = w * w - x * x - y * y + z * z;
}

/* The rotations (m, 9) of m segments of rates, and their sensitivities (m, 9, REGRESSORS), if regressors are given. */
CLONES EXPORT void gnomon_integrate_rates(int64_t m, const int64_t *lengths, const double *omega, const double *dt,
                                          const double *regressors, double *rotation, double *sensitivity) {
    for (int64_t k = 0; k < m; k++, rotation += 9, sensitivity += 9 * REGRESSORS) {
        double q[4] = {1.0, 0.0, 0.0, 0.0}, before = 0.0, sums[9 * REGRESSORS] = {0.0};
        for (int64_t i = 0; i < lengths[k]; i++, omega += 3, dt++) {
            if (regressors) {
                double path[9];
                rotation_from_quaternion(q, path);
                for (int r = 0; r < 9; r++) path[r] *= 0.5 * (before + *dt);
                for (int c = 0; c < REGRESSORS; c++)
                    for (int r = 0; r < 9; r++) sums[9 * c + r] += path[r] * regressors[c];
                regressors += REGRESSORS, before = *dt;
            }
            if (i + 1 < lengths[k]) {
                double step[4], product[4];
                rk4n_step(omega, omega + 3, *dt, step);
                hamilton(q, step, product);
                memcpy(q, product, sizeof(q));
            }
        }
        rotation_from_quaternion(q, rotation);
        for (int r = 0; r < 9; r++)
            for (int c = 0; c < REGRESSORS; c++) sensitivity[REGRESSORS * r + c] = sums[9 * c + r];
    }
}

/* sums for Allan variances (estimate/allan/deviation.py): S[k] of the first k samples, z_m(k) = S[k + 2 m] - 2 S[k + m] +
   S[k] */

#if defined(__GNUC__) && !defined(__clang__)
#define FUSED __attribute__((optimize("fp-contract=fast"))) /* a product and a sum in one */
#else
#define FUSED
#endif
#define TIMES 6      /* averaging times m, 2 m, 4 m, ... whose squares are added up in one pass */
#define SHORT 12     /* averaging times of 1, 2, 4, ... samples, a multiple of TIMES */
#define STRETCH 8192 /* terms whose sums stay in the nearer memory for all of them, in rows */
#define ROW 4096     /* 2^SHORT */
#define AHEAD 100    /* samples that are asked for before they are needed */

#if defined(__GNUC__)
typedef double Lane __attribute__((vector_size(32), aligned(8), may_alias));
#else
typedef double Lane;
#endif
#define LANES ((int64_t)(sizeof(Lane) / sizeof(double)))

#if defined(__GNUC__)
INLINE void fetch(const double *later) { __builtin_prefetch(later); }
#else
INLINE void fetch(const double *later) { (void)later; }
#endif

INLINE double added(const Lane *lane) {
    const double *each = (const double *)lane;
    double sum = 0.0;
    for (int64_t j = 0; j < LANES; j++) sum += each[j];
    return sum;
}

INLINE double allan_total(int64_t n, const double *S) {
    Lane total[4] = {{0.0}};
    double sum = 0.0;
    int64_t k = 0;
    for (; k + 4 * LANES <= n; k += 4 * LANES)
        for (int j = 0; j < 4; j++) total[j] += *(const Lane *)(S + k + j * LANES);
    for (; k < n; k++) sum += S[k];
    for (int j = 0; j < 4; j++) sum += added(total + j);
    return sum;
}

/* Adds up z^2 of terms that begin from start to stop, for the first `times` of the averaging times m, 2 m, 4 m, ... */
INLINE void allan_squares(int64_t start, int64_t stop, int64_t m, int times, const double *S, double *squares) {
    Lane total[TIMES] = {{0.0}};
    for (; start + LANES <= stop; start += LANES) {
        const double *s = S + start;
        const Lane first = *(const Lane *)s;
        Lane near = *(const Lane *)(s + m) - first;
        for (int time = 0; time < times; time++) {
            const Lane far = *(const Lane *)(s + (m << (time + 1))) - first, z = far - 2.0 * near;
            total[time] += z * z, near = far;
        }
    }
    for (int time = 0; time < times; time++) {
        squares[time] += added(total + time);
        for (int64_t k = start; k < stop; k++) {
            const double z = S[k + (m << (time + 1))] - 2.0 * S[k + (m << time)] + S[k];
            squares[time] += z * z;
        }
    }
}

#if defined(__GNUC__) && defined(__x86_64__)
typedef double Wide __attribute__((vector_size(64), aligned(8), may_alias));

/* The same for TIMES of them, eight terms at once where the processor can; returns where it left off. */
FUSED __attribute__((target("avx512f"))) static int64_t allan_wide(int64_t start, int64_t stop, int64_t m, const double *S,
                                                                   double *squares) {
    Wide total[TIMES] = {{0.0}};
    for (; start + 8 <= stop; start += 8) {
        const double *s = S + start;
        const Wide first = *(const Wide *)s;
        Wide near = *(const Wide *)(s + m) - first;
        for (int time = 0; time < TIMES; time++) {
            const Wide far = *(const Wide *)(s + (m << (time + 1))) - first, z = far - 2.0 * near;
            total[time] += z * z, near = far;
        }
    }
    for (int time = 0; time < TIMES; time++)
        for (int j = 0; j < 8; j++) squares[time] += ((const double *)(total + time))[j];
    return start;
}
#else
#define allan_wide(start, stop, m, S, squares) (start)
#define __builtin_cpu_supports(what) 0
#endif

/* The same of S (n), at whose end longer averaging times have fewer terms. */
INLINE void allan_terms(int64_t start, int64_t stop, int64_t n, int64_t m, int times, const double *S, double *squares) {
    for (; times && start < stop; times--) {
        const int64_t left = n - (m << times), to = left < start ? start : left < stop ? left : stop;
        switch (times) {
        case TIMES:
            if (__builtin_cpu_supports("avx512f")) start = allan_wide(start, to, m, S, squares);
            allan_squares(start, to, m, TIMES, S, squares);
            break;
        case 5: allan_squares(start, to, m, 5, S, squares); break;
        case 4: allan_squares(start, to, m, 4, S, squares); break;
        case 3: allan_squares(start, to, m, 3, S, squares); break;
        case 2: allan_squares(start, to, m, 2, S, squares); break;
        default: allan_squares(start, to, m, 1, S, squares);
        }
        start = to;
    }
}

/* Goes on adding up samples (n, 3) about `zero` (3): S (3 times `apart`), sum being what is before the first. */
INLINE void allan_add_up(int64_t n, const double *y, int64_t step, int64_t across, const double *zero, int64_t apart,
                         double *S, double *sum) {
    const double zero_0 = zero[0], zero_1 = zero[1], zero_2 = zero[2];
    double sum_0 = sum[0], sum_1 = sum[1], sum_2 = sum[2];
    for (int64_t k = 0; k < n; k++, y += step) {
        fetch(y + AHEAD * step);
        S[k] = sum_0 += y[0] - zero_0;
        S[k + apart] = sum_1 += y[across] - zero_1;
        S[k + 2 * apart] = sum_2 += y[2 * across] - zero_2;
    }
    sum[0] = sum_0, sum[1] = sum_1, sum[2] = sum_2;
}

INLINE double *aligned(double *memory) { return (double *)(((uintptr_t)memory + 63) & ~(uintptr_t)63); }

/* Of samples (n, 3) about `zero` (3), `step` from one to the next and `across` from axis to axis, of which the first
   `count` begin a term. marks: S[0], S[ROW], S[2 ROW], ... (., 3) up to S[count], `end` the last (3); squares: of z (3,
   SHORT); line: sums of the first `count` of S (3); thinned: sums (., 3) of `stride` samples each, if that is above 1;
   work: 3 (STRETCH + ROW + 8) + 8. */
FUSED CLONES EXPORT void gnomon_allan_short(int64_t n, const double *y, int64_t step, int64_t across, const double *zero,
                                      int64_t count, int64_t stride, double *marks, double *end, double *squares,
                                      double *line, double *thinned, double *work) {
    const int64_t apart = STRETCH + ROW + 8;
    double *S = aligned(work), sum[3] = {0.0}; /* of this stretch, and what its terms reach beyond */
    for (int i = 0; i < 3; i++) S[i * apart] = 0.0;
    for (int64_t start = 0, known = 0; start < count; start += STRETCH) {
        const int64_t stop = count - start < STRETCH ? count : start + STRETCH, next = stop + ROW < n ? stop + ROW : n;
        if (start)
            for (int i = 0; i < 3; i++)
                memcpy(S + i * apart, S + i * apart + STRETCH, (size_t)(known - start + 1) * sizeof(double));
        allan_add_up(next - known, y + known * step, step, across, zero, apart, S + known - start + 1, sum);
        known = next;
        for (int i = 0; i < 3; i++) {
            const double *s = S + i * apart;
            for (int64_t k = start; k < stop || k == count; k += ROW) marks[k / ROW * 3 + i] = s[k - start];
            for (int64_t k = start; stride > 1 && k < stop && k + stride <= count; k += stride)
                thinned[k / stride * 3 + i] = s[k - start + stride] - s[k - start];
            end[i] = s[stop - start];
            line[i] += allan_total(stop - start, s);
            for (int time = 0; time < SHORT; time += TIMES)
                allan_terms(0, stop - start, n + 1 - start, (int64_t)1 << time, TIMES, s, squares + SHORT * i + time);
        }
    }
}

/* Of S in rows of m (n in all), which begin with `marks` (rows, 3) and go on with samples (., 3) about `zero` (3), for
   averaging times of m, 2 m, 4 m, ... places, `width` places of the rows at once; marks are changed; work: 3 width
   (rows + 1) + 8. totals: sums of z. */
FUSED CLONES EXPORT void gnomon_allan_long(int64_t n, const double *const *y, double *marks, const double *zero, int64_t m,
                                     int64_t width, int64_t levels, double *work, double *squares, double *totals) {
    const int64_t rows = n / m, rest = n % m, apart = width * (rows + 1); /* the first places have a row more */
    const double zero_0 = zero[0], zero_1 = zero[1], zero_2 = zero[2];
    work = aligned(work);
    for (int64_t first = 0; first < m;) {
        const int64_t stop = first < rest ? rest : m, columns = stop - first < width ? stop - first : width;
        const int64_t height = first < rest ? rows + 1 : rows, length = height * columns;
        for (int64_t r = 0; r < height; r++) {
            double sum_0 = marks[3 * r], sum_1 = marks[3 * r + 1], sum_2 = marks[3 * r + 2], *s = work + r * columns;
            const double *later = y[r + 4 < height ? r + 4 : r] + 3 * first;
            for (int64_t k = 0; k < columns; k++) {
                fetch(later + 3 * k);
                if (first + k) {
                    const double *sample = y[r] + 3 * (first + k - 1);
                    sum_0 += sample[0] - zero_0, sum_1 += sample[1] - zero_1, sum_2 += sample[2] - zero_2;
                }
                s[k] = sum_0, s[k + apart] = sum_1, s[k + 2 * apart] = sum_2;
            }
            marks[3 * r] = sum_0, marks[3 * r + 1] = sum_1, marks[3 * r + 2] = sum_2;
        }
        for (int i = 0; i < 3; i++) {
            const double *s = work + i * apart;
            for (int64_t level = 0, times; level < levels; level += times) {
                times = levels - level < TIMES ? levels - level : TIMES;
                allan_terms(0, length, length, columns << level, (int)times, s, squares + i * levels + level);
            }
            double head = allan_total(columns, s), tail = allan_total(columns, s + length - columns);
            for (int64_t level = 0, lag = columns; level < levels && 2 * lag < length; level++, lag *= 2) {
                /* of all z, what is left of their terms is at either end */
                const double inner = allan_total(lag, s + lag), outer = allan_total(lag, s + length - 2 * lag);
                totals[i * levels + level] += (tail - outer) - (inner - head);
                head += inner, tail += outer;
            }
        }
        first += columns;
    }
}

/* fits of corners (detect/boards/corner_fit.py), in single precision pixel by pixel, as there */

#define CORNER 9    /* parameters of a corner: place, angles, blurs, correlation, mean and half difference of the greys */
#define PIXELS 512  /* of a window, at most, a multiple of EACH */
#define EACH 8      /* numbers that a processor adds at once */

typedef struct {
    double converged[6], longest[7], blur[2], correlation, noise, blurs_alike, correlation_known, hopeless, damping;
    double iterations, soon, saturated;
} CornerRules;

typedef struct {
    float of[CORNER + 1][PIXELS], along[2][PIXELS]; /* derivatives and residuals, distances along both edges [px] */
} CornerColumns;

INLINE float exponential(float x) { /* of -30 ... 0, to 1e-7 */
    const float t = 1.44269504f * x;
    const int32_t whole = (int32_t)(t - 0.5f);
    const float r = 0.693147181f * (t - (float)whole);
    union { int32_t bits; float value; } power = {(whole + 127) << 23};
    return power.value *
           (1 + r * (1 + r * (0.5f + r * (1 / 6.0f + r * (1 / 24.0f + r * (1 / 120.0f + r * (1 / 720.0f)))))));
}

/* 2 Phi(a) - 1, to 2.5e-5 (Abramowitz and Stegun 7.1.25), and phi(a). */
INLINE float normal_distribution(float a, float *phi) {
    const float square = a * a, e = exponential(-0.5f * (square < 60.0f ? square : 60.0f));
    const float t = 1 / (1 + fabsf(a) * (float)(0.47047 / 1.4142135623730951));
    *phi = e * 0.39894228f;
    return copysignf(1 - ((t * 0.7478556f - 0.0958798f) * t + 0.3480242f) * t * e, a);
}

INLINE void corner_columns(int64_t n, const float *value, const float *place, const float *weight,
                                  int saturated, int tip, const double *state, CornerColumns *columns) {
    const double cos1 = cos(state[2]), sin1 = sin(state[2]), cos2 = cos(state[3]), sin2 = sin(state[3]);
    const double u = state[0], v = state[1];
    const float x1 = (float)(cos1 / state[4]), y1 = (float)(sin1 / state[4]), z1 = (float)(-(cos1 * u + sin1 * v) / state[4]);
    const float x2 = (float)(cos2 / state[5]), y2 = (float)(sin2 / state[5]), z2 = (float)(-(cos2 * u + sin2 * v) / state[5]);
    const float s1 = (float)sin1, c1 = (float)cos1, w1 = (float)(cos1 * v - sin1 * u);
    const float s2 = (float)sin2, c2 = (float)cos2, w2 = (float)(cos2 * v - sin2 * u);
    const float by1 = (float)(1 / state[4]), by2 = (float)(1 / state[5]);
    const float rho = (float)state[6], middle = (float)state[7], amplitude = (float)state[8];
    const float factor = tip ? 2 : 4, half = tip ? 0.5f : 1, shift = tip ? 0.5f : 0, most = saturated ? 255.0f : INFINITY;
    const float least = saturated ? 0.0f : -INFINITY;
    const int64_t padded = (n + EACH - 1) / EACH * EACH;
    float (*of)[PIXELS] = columns->of;
    for (int64_t i = 0; i < n; i++) {
        const float x = place[i], y = place[n + i], a1 = x1 * x + y1 * y + z1, a2 = x2 * x + y2 * y + z2;
        const float along1 = s1 * x - c1 * y + w1, along2 = s2 * x - c2 * y + w2;
        float phi1, phi2;
        const float dark1 = shift + half * normal_distribution(a1, &phi1);
        const float dark2 = shift + half * normal_distribution(a2, &phi2);
        const float both = factor * phi1 * phi2, product = a1 * a2 * rho, bend = rho * (1 + 0.5f * product);
        const float picture = (1 + 2 * shift) * dark1 * dark2 - 2 * shift + both * bend;
        const float model = middle - amplitude * picture;
        const int beyond = ((value[i] >= most) & (model > 254.5f)) | ((value[i] <= least) & (model < 0.5f));
        const float w = weight[i] * (float)(1 - beyond), scale = w * amplitude;
        const float first = scale * by1 * (both * (0.5f * rho * rho * a2 - a1 * bend) + 2 * phi1 * dark2);
        const float second = scale * by2 * (both * (0.5f * rho * rho * a1 - a2 * bend) + 2 * phi2 * dark1);
        of[0][i] = first, of[1][i] = second;
        of[2][i] = first * along1, of[3][i] = second * along2;
        of[4][i] = first * a1, of[5][i] = second * a2;
        of[6][i] = -scale * both * (product + 1);
        of[7][i] = w, of[8][i] = -w * picture, of[9][i] = w * (value[i] - model);
        columns->along[0][i] = along1, columns->along[1][i] = along2;
    }
    for (int k = 0; k <= CORNER; k++)
        for (int64_t i = n; i < padded; i++) of[k][i] = 0.0f;
}

INLINE double dot_single(int64_t padded, const float *a, const float *b) {
    float sums[EACH] = {0};
    for (int64_t i = 0; i < padded; i += EACH)
        for (int j = 0; j < EACH; j++) sums[j] += a[i + j] * b[i + j];
    double total = 0.0;
    for (int j = 0; j < EACH; j++) total += sums[j];
    return total;
}

/* Solves a x = b for several sides (CORNER, k), in place of b; a is damped, and lost. */
static void solve_damped(double a[CORNER][CORNER], double *b, int k, double damping) {
    for (int i = 0; i < CORNER; i++) a[i][i] = a[i][i] * (1 + damping) + 1e-6;
    for (int i = 0; i < CORNER; i++) {
        int pivot = i;
        for (int r = i + 1; r < CORNER; r++) pivot = fabs(a[r][i]) > fabs(a[pivot][i]) ? r : pivot;
        for (int j = 0; j < CORNER && pivot != i; j++) {
            const double kept = a[i][j];
            a[i][j] = a[pivot][j], a[pivot][j] = kept;
        }
        for (int j = 0; j < k && pivot != i; j++) {
            const double kept = b[i * k + j];
            b[i * k + j] = b[pivot * k + j], b[pivot * k + j] = kept;
        }
        for (int r = i + 1; r < CORNER; r++) {
            const double share = a[r][i] / a[i][i];
            for (int j = i + 1; j < CORNER; j++) a[r][j] -= share * a[i][j];
            for (int j = 0; j < k; j++) b[r * k + j] -= share * b[i * k + j];
        }
    }
    for (int i = CORNER - 1; i >= 0; i--)
        for (int j = 0; j < k; j++) {
            for (int r = i + 1; r < CORNER; r++) b[i * k + j] -= a[i][r] * b[r * k + j];
            b[i * k + j] /= a[i][i];
        }
}

/* Moves in pixels (2, k) of offsets (2, k) along the normals of a state. */
static void by_normals(const double *state, const double *offsets, int k, int stride, double *moves) {
    const double cos1 = cos(state[2]), sin1 = sin(state[2]), cos2 = cos(state[3]), sin2 = sin(state[3]);
    double sine = cos1 * sin2 - cos2 * sin1;
    if (fabs(sine) < 1e-3) sine = copysign(1e-3, sine);
    for (int j = 0; j < k; j++) {
        const double first = offsets[j], second = offsets[stride + j];
        moves[j] = (sin2 * first - sin1 * second) / sine;
        moves[k + j] = (cos1 * second - cos2 * first) / sine;
    }
}

static inline double clipped(double value, double low, double high) {
    return value < low ? low : value > high ? high : value;
}

/* What the fit makes of edges that bend, and of light that grows: moves (2, 2) each. */
INLINE void corner_left_out(int64_t n, const float *value, const float *place, const CornerColumns *columns,
                            const double *state, double normal[][CORNER + 1], double damping, double *bow,
                            double *slope) {
    static const int others = 4;
    const int64_t padded = (n + EACH - 1) / EACH * EACH;
    float left_out[4][PIXELS];
    double matrix[CORNER][CORNER], sides[CORNER * 4], moves[8];
    for (int e = 0; e < 2; e++) {
        const float square = (float)(state[4 + e] * state[4 + e]), at = (float)state[e];
        for (int64_t i = 0; i < n; i++) {
            left_out[e][i] = 0.5f * (columns->of[2 + e][i] * columns->along[e][i] + columns->of[e][i] * square);
            left_out[2 + e][i] = (place[e * n + i] - at) * columns->of[7][i] * value[i];
        }
    }
    for (int j = 0; j < others; j++)
        for (int64_t i = n; i < padded; i++) left_out[j][i] = 0.0f;
    for (int i = 0; i < CORNER; i++) {
        for (int j = 0; j < CORNER; j++) matrix[i][j] = normal[i][j];
        for (int j = 0; j < others; j++) sides[i * others + j] = dot_single(padded, columns->of[i], left_out[j]);
    }
    solve_damped(matrix, sides, others, damping);
    by_normals(state, sides, others, others, moves);
    for (int r = 0; r < 2; r++)
        for (int j = 0; j < 2; j++) bow[2 * r + j] = moves[4 * r + j], slope[2 * r + j] = moves[4 * r + 2 + j];
}

/* Moves the state (m, 9) of each active corner to where its window (m, n) is met best; see `_descend` there.

   The places (m or 1, 3, n) of the pixels are those of each window, or of all. Written: covariances of the offsets
   (m, 2, 2), variances of the residuals (m,), and moves by what is left out (m, 2, 2) each. */
CLONES EXPORT void gnomon_descend_corners(int64_t m, int64_t n, int64_t shared, const float *values,
                                          const float *places, const float *weights, int64_t tip,
                                          const CornerRules *rules, const uint8_t *active, double *states,
                                          double *covariance, double *variance, double *bow, double *slope) {
    const int64_t padded = (n + EACH - 1) / EACH * EACH;
    CornerColumns columns;
    for (int64_t corner = 0; corner < m; corner++) {
        if (!active[corner]) continue;
        const float *value = values + corner * n, *weight = weights + corner * n;
        const float *place = shared ? places : places + 3 * corner * n;
        double *state = states + CORNER * corner;
        for (int k = 0, done = 0; !done; k++) {
            double normal[CORNER + 1][CORNER + 1], matrix[CORNER][CORNER], sides[3 * CORNER] = {0}, moved[2], at[CORNER];
            corner_columns(n, value, place, weight, rules->saturated != 0, tip != 0, state, &columns);
            for (int i = 0; i <= CORNER; i++)
                for (int j = i; j <= CORNER; j++)
                    normal[i][j] = normal[j][i] = dot_single(padded, columns.of[i], columns.of[j]);
            const double noise = rules->noise * 2 * state[8], alike = noise * noise / (rules->blurs_alike * rules->blurs_alike);
            const double known = noise * noise / (rules->correlation_known * rules->correlation_known);
            for (int i = 0; i < CORNER; i++) {
                for (int j = 0; j < CORNER; j++) matrix[i][j] = normal[i][j];
                sides[3 * i] = normal[i][CORNER];
                at[i] = state[i];
            }
            sides[1] = sides[3 + 2] = 1.0;
            matrix[4][4] += alike, matrix[5][5] += alike, matrix[4][5] -= alike, matrix[5][4] -= alike;
            sides[3 * 4] += alike * (at[5] - at[4]), sides[3 * 5] += alike * (at[4] - at[5]);
            matrix[6][6] += known, sides[3 * 6] += known * (cos(at[2] - at[3]) - at[6]);
            solve_damped(matrix, sides, 3, rules->damping);
            double longest = 1.0, along = 0.0, bend = 0.0, step[CORNER];
            for (int i = 0; i < 7; i++) {
                const double length = fabs(sides[3 * i]) / rules->longest[i];
                longest = length > longest ? length : longest;
            }
            for (int i = 0; i < CORNER; i++) step[i] = sides[3 * i] / longest;
            for (int i = 0; i < CORNER; i++) {
                along += normal[i][CORNER] * step[i];
                for (int j = 0; j < CORNER; j++) bend += step[i] * normal[i][j] * step[j];
            }
            const double rest = normal[CORNER][CORNER] - 2 * along + bend, count = normal[7][7] - CORNER;
            variance[corner] = (rest > 0 ? rest : rest == rest ? 0.0 : rest) / (count > 1 ? count : 1.0);
            for (int i = 0; i < 4; i++) covariance[4 * corner + i] = sides[3 * (i / 2) + 1 + i % 2];
            by_normals(at, step, 1, 1, moved);
            state[0] += moved[0], state[1] += moved[1];
            for (int i = 2; i < CORNER; i++) state[i] += step[i];
            for (int i = 4; i < 6; i++) state[i] = clipped(state[i], rules->blur[0], rules->blur[1]);
            state[6] = clipped(state[6], -rules->correlation, rules->correlation);
            done = !rules->saturated;
            for (int i = 0; i < 6; i++) done = done && !(fabs(step[i]) > rules->converged[i]);
            const double hopeless = rules->hopeless * 2 * state[8];
            done = done || k >= (int)rules->iterations - 1;
            done = done || (k >= (int)rules->soon && !(variance[corner] < hopeless * hopeless));
            if (done)
                corner_left_out(n, value, place, &columns, at, normal, rules->damping, bow + 4 * corner, slope + 4 * corner);
        }
    }
}

/* maps from a board to an image (detect/boards/tag_places.py, plane_map.py) */

#define NINE 9

/* What moves points (n, 2) to zero mean and unit spread: by this factor, from there. */
static double spread_of(int64_t n, const double *points, double *mean) {
    double square = 0.0;
    mean[0] = mean[1] = 0.0;
    for (int64_t i = 0; i < n; i++) mean[0] += points[2 * i], mean[1] += points[2 * i + 1];
    mean[0] /= (double)n, mean[1] /= (double)n;
    for (int64_t i = 0; i < n; i++)
        for (int k = 0; k < 2; k++) square += (points[2 * i + k] - mean[k]) * (points[2 * i + k] - mean[k]);
    square = sqrt(square / (2.0 * (double)n));
    return 1.0 / (square > 1e-12 ? square : 1e-12);
}

/* The eigenvector of the least eigenvalue of a matrix, positive but for rounding, by inverse iteration. */
static void least_eigenvector(double a[NINE][NINE], double *x) {
    double size = 0.0;
    for (int i = 0; i < NINE; i++) size += a[i][i];
    for (int i = 0; i < NINE; i++) a[i][i] += 1e-15 * size, x[i] = 1.0 / (i + 1.5);
    for (int i = 0; i < NINE; i++) /* L D L', in place */
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k] * a[k][k];
            a[i][j] = j < i ? sum / a[j][j] : sum > 1e-17 * size ? sum : 1e-17 * size;
        }
    double moved = 1.0;
    for (int turn = 0; turn < 100 && moved > 1e-15; turn++) {
        double y[NINE], square = 0.0, along = 0.0;
        for (int i = 0; i < NINE; i++) {
            y[i] = x[i];
            for (int k = 0; k < i; k++) y[i] -= a[i][k] * y[k];
        }
        for (int i = NINE - 1; i >= 0; i--) {
            y[i] /= a[i][i];
            for (int k = i + 1; k < NINE; k++) y[i] -= a[k][i] * y[k];
            square += y[i] * y[i], along += y[i] * x[i];
        }
        moved = 0.0;
        for (int i = 0; i < NINE; i++) {
            y[i] /= copysign(sqrt(square), along);
            moved = fmax(moved, fabs(y[i] - x[i]));
            x[i] = y[i];
        }
    }
}

/* The homography (3, 3) that maps points (n, 2) to pixels (n, 2) best, by algebraic distance. */
CLONES EXPORT void gnomon_fit_homography(int64_t n, const double *points, const double *pixels, double *H) {
    double from[2], to[2], sums[4][3][3] = {0}, normal[NINE][NINE] = {0}, h[NINE], moved[9];
    const double scale = spread_of(n, points, from), stretch = spread_of(n, pixels, to);
    for (int64_t i = 0; i < n; i++) {
        const double p[3] = {scale * (points[2 * i] - from[0]), scale * (points[2 * i + 1] - from[1]), 1.0};
        const double u = stretch * (pixels[2 * i] - to[0]), v = stretch * (pixels[2 * i + 1] - to[1]);
        const double by[4] = {1.0, -u, -v, u * u + v * v};
        for (int k = 0; k < 4; k++)
            for (int r = 0; r < 3; r++)
                for (int c = 0; c < 3; c++) sums[k][r][c] += by[k] * p[r] * p[c];
    }
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            normal[r][c] = normal[3 + r][3 + c] = sums[0][r][c];
            normal[r][6 + c] = normal[6 + r][c] = sums[1][r][c];
            normal[3 + r][6 + c] = normal[6 + r][3 + c] = sums[2][r][c];
            normal[6 + r][6 + c] = sums[3][r][c];
        }
    least_eigenvector(normal, h);
    const double back[9] = {1 / stretch, 0, to[0], 0, 1 / stretch, to[1], 0, 0, 1};
    const double there[9] = {scale, 0, -scale * from[0], 0, scale, -scale * from[1], 0, 0, 1};
    multiply(h, there, moved);
    multiply(back, moved, H);
}

/* pictures (readers/images/image_pixels.py) */

INLINE void undo_png_filter(int filter, int64_t width, const uint8_t *x, const uint8_t *above, uint8_t *pixels) {
    unsigned left = 0, corner = 0;
    for (int64_t i = 0; i < width; i++) {
        const unsigned up = above ? above[i] : 0;
        unsigned by = filter == 1 ? left : filter == 2 ? up : filter == 3 ? (left + up) >> 1 : 0;
        if (filter == 4) { /* Paeth: of left, above and corner the nearest to left + above - corner */
            const int a = (int)up - (int)corner, b = (int)left - (int)corner, c = a + b;
            const int far = a < 0 ? -a : a, across = b < 0 ? -b : b, both = c < 0 ? -c : c;
            by = far <= across && far <= both ? left : across <= both ? up : corner;
        }
        corner = up;
        pixels[i] = (uint8_t)(left = (x[i] + by) & 255);
    }
}

/* Undoes the filters of the rows of a PNG of one byte a pixel (ISO/IEC 15948, 9.2): each has the number of its filter
   before its bytes. Returns other than 0 where there is no such filter. */
EXPORT int64_t gnomon_undo_png_filters(int64_t height, int64_t width, const uint8_t *rows, uint8_t *pixels) {
    for (int64_t r = 0; r < height; r++, rows += width + 1, pixels += width) {
        const uint8_t *x = rows + 1, *above = r ? pixels - width : 0;
        switch (rows[0]) { /* so that each filter has a loop of its own */
        case 0: memcpy(pixels, x, (size_t)width); break;
        case 1: undo_png_filter(1, width, x, above, pixels); break;
        case 2: undo_png_filter(2, width, x, above, pixels); break;
        case 3: undo_png_filter(3, width, x, above, pixels); break;
        case 4: undo_png_filter(4, width, x, above, pixels); break;
        default: return 1;
        }
    }
    return 0;
}

/* tables (writers/apply.py, readers/samples/text_table.py) */

/* Writes lines of a table, of the JSON texts [1,2] and [[3,4],[5,6]]: 1,3,4 and 2,5,6. Returns how many bytes. */
EXPORT int64_t gnomon_join_columns(const char *first, const char *others, char *lines) {
    char *out = lines;
    for (others++, first++; *others == '['; first++) {
        while (*first != ',' && *first != ']') *out++ = *first++;
        *out++ = ',';
        for (others++; *others != ']'; others++) *out++ = *others;
        *out++ = '\n';
        if (*++others == ',') others++;
    }
    return out - lines;
}

#define EXACT (1ULL << 53) /* doubles hold all whole numbers up to here, and 10^k up to k = 22 */
static const double TENS[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                              1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

/* Reads a decimal number into 8 bytes, a whole one as an integer; NULL where it is none, or needs more digits than are
   exact: so one division or product rounds it to the nearest double. Returns where it ends. */
INLINE const char *read_number(const char *at, int whole, void *value) {
    int negative = *at == '-', digits = 0, tens = 0, power = 0;
    uint64_t number = 0;
    if (*at == '-' || *at == '+') at++;
    for (; *at >= '0' && *at <= '9'; at++, digits++) number = 10 * number + (uint64_t)(*at - '0');
    if (whole) {
        int64_t found = negative ? -(int64_t)number : (int64_t)number;
        memcpy(value, &found, 8);
        return digits && digits < 19 + (number >> 63 == 0) ? at : NULL;
    }
    if (*at == '.')
        for (at++; *at >= '0' && *at <= '9'; at++, digits++, tens--) number = 10 * number + (uint64_t)(*at - '0');
    if (!digits || digits > 19 || number > EXACT) return NULL;
    if (*at == 'e' || *at == 'E') {
        int down = *++at == '-';
        if (*at == '-' || *at == '+') at++;
        const char *first = at;
        for (; *at >= '0' && *at <= '9' && at - first < 4; at++) power = 10 * power + (*at - '0');
        if (at == first) return NULL;
        tens += down ? -power : power;
    }
    if (tens < -22 || tens > 22) return NULL;
    double found = tens < 0 ? (double)number / TENS[-tens] : (double)number * TENS[tens];
    if (negative) found = -found;
    memcpy(value, &found, 8);
    return at;
}

INLINE const char *skip_spaces(const char *at, int64_t between) {
    while (*at == ' ' || (*at == '\t' && between != '\t')) at++;
    return at;
}

/* Reads lines of numbers, as many in each, apart by a byte, or by white space where that is ' '; the text ends with a
   zero byte. Those of a column that is `whole` are integers. Returns how many lines; -1 where one is anything else. */
EXPORT int64_t gnomon_read_table(const char *text, int64_t between, int64_t columns, const uint8_t *whole,
                                 double *values) {
    int64_t lines = 0;
    for (const char *at = text; *at;) {
        if (*at == '\n') {
            at++;
            continue;
        }
        for (int64_t k = 0; k < columns; k++) {
            const char *begin = at;
            at = skip_spaces(at, between);
            if (k && between == ' ' && at == begin) return -1;
            if (k && between != ' ' && *at++ != between) return -1;
            at = read_number(skip_spaces(at, between), whole[k], values++);
            if (!at) return -1;
        }
        at = skip_spaces(at, between);
        if (*at == '\r') at++;
        if (*at && *at++ != '\n') return -1;
        lines++;
    }
    return lines;
}
