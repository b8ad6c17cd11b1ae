/* The loops in which a camera-IMU calibration spends its time: rows of the inertial error terms, sums over the corners
   of an exposure, and what is added to the normal equations; rotations from rates; running sums for Allan variances; and
   the fit of corners to the pixels around them, and of a board to its corners; rows of a PNG, and of a table. Each does what the NumPy code beside its
   caller does (estimate/camera_imu/terms, estimate/multiposition, estimate/allan, detect), to rounding; equations and
   names are explained there. C99, no library but the mathematical one. Matrices are 3 x 3, row by row. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* The same source for processors with and without AVX2, chosen when it is loaded. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define CLONES __attribute__((target_clones("arch=haswell", "default")))
#else
#define CLONES
#endif

/* So that the clones of a function are made of it, too. */
#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline))
#else
#define INLINE static inline
#endif

#define INTERFACE 6 /* changes whenever the arguments of a function do */
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

/* rotation vectors, as geometry/rotation_vector.py has them */

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

/* Rows (n, height, width) of readings, whitened; `chi2` grows by the squares of the residuals of both triads.

   bases (4, order, order) polynomials, by powers of u, of the basis functions and three derivatives by time
   controls (., scalars), the biases of this IMU from column `bias_at` on, those of a span's knots `offset` further
   read and weight: (n, 3) and (n,) of the gyroscope, then of the accelerometer; null where there is none */
EXPORT void gnomon_inertial_rows(int64_t n, int64_t order, int64_t width, const int64_t *first, const double *u,
                                 const int64_t *segment, const double *references, const double *bases,
                                 const double *controls, int64_t scalars, int64_t bias_at, int64_t offset,
                                 double spacing, const Imu *imu, const Blocks *blocks, const double *read_g,
                                 const double *weight_g, const double *read_a, const double *weight_a, double *rows,
                                 double *chi2) {
    const int64_t height = (read_g ? 3 : 0) + (read_a ? 3 : 0);
    memset(rows, 0, (size_t)(n * height * width) * sizeof(double));
    for (int64_t k = 0; k < n; k++) {
        double basis[4 * ORDER], bias[6], residual[3], *row = rows + k * height * width;
        Moment at;
        for (int64_t d = 0; d < 4; d++)
            for (int64_t a = 0; a < order; a++) {
                double total = 0.0;
                for (int64_t power = order - 1; power >= 0; power--)
                    total = total * u[k] + bases[(d * order + power) * order + a];
                basis[d * order + a] = total;
            }
        move(controls + first[k] * scalars, scalars, order, basis, references + 9 * segment[k], imu, &at);
        const double *knot = controls + (first[k] + offset) * scalars + bias_at;
        for (int i = 0; i < 6; i++) {
            bias[i] = knot[i] * (1 - u[k]) + knot[scalars + i] * u[k];
            at.bias_rate[i] = (knot[scalars + i] - knot[i]) / spacing;
        }
        if (read_g) {
            put_gyroscope(row, width, order, basis, u[k], imu, blocks, &at, bias, read_g + 3 * k, weight_g[k], residual);
            chi2[0] += dot(residual, residual) * weight_g[k] * weight_g[k];
            row += 3 * width;
        }
        if (read_a) {
            put_accelerometer(row, width, order, basis, u[k], imu, blocks, &at, bias + 3, read_a + 3 * k, weight_a[k],
                              residual);
            chi2[1] += dot(residual, residual) * weight_a[k] * weight_a[k];
        }
    }
}

/* normal equations */

/* Adds the products (s, b, w) of the rows of some spans, b columns of pose and biases by all, to band and tail, as
   `_add_spans` of the assembly does.

   band: (n, 6, order, 6) of pose by pose, pose by bias, bias by pose, bias by bias; the last three null without biases
   tail (n, scalars, length), `bias_at` the first scalar of the biases, columns (w - b) where in it the last ones belong
   spans (s) first control point of each, offset of a span's bias knots from it */
CLONES EXPORT void gnomon_add_spans(int64_t s, int64_t order, int64_t w, const double *sums, const int64_t *spans,
                                    int64_t offset, double *pose_pose, double *pose_bias, double *bias_pose,
                                    double *bias_bias, double *tail, int64_t scalars, int64_t length, int64_t bias_at,
                                    const int64_t *columns) {
    const int64_t pose = 6 * order, b = pose + (pose_bias ? 12 : 0), block = 36 * order, line = 6 * order;
    for (int64_t k = 0; k < s; k++) {
        const double *product = sums + k * b * w;
        for (int64_t row = 0; row < b; row++) {
            const double *values = product + row * w;
            const int64_t which = row / 6, i = row % 6, knot = which - order;
            const int64_t control = spans[k] + (row < pose ? which : offset + knot);
            double *end = tail + (control * scalars + (row < pose ? i : bias_at + i)) * length;
            for (int64_t j = b; j < w; j++) end[columns[j - b]] += values[j];
            if (row < pose) {
                double *own = pose_pose + control * block + i * line;
                for (int64_t j = 6 * which; j < pose; j++) own[j - 6 * which] += values[j];
                for (int64_t other = 0; pose_bias && other < 2; other++) {
                    const double *found = values + pose + 6 * other;
                    const int64_t apart = offset + other - which;
                    if (apart >= 0) {
                        double *to = pose_bias + control * block + i * line + 6 * apart;
                        for (int j = 0; j < 6; j++) to[j] += found[j];
                    } else {
                        double *to = bias_pose + (spans[k] + offset + other) * block - 6 * apart + i;
                        for (int j = 0; j < 6; j++) to[j * line] += found[j];
                    }
                }
            } else {
                double *own = bias_bias + control * block + i * line;
                for (int64_t j = pose + 6 * knot; j < b; j++) own[j - pose - 6 * knot] += values[j];
            }
        }
    }
}

/* corners */

/* What the columns of one corner add to the upper triangle of its exposure's sums, in rows of `stride`, of fours. */
static inline void add_products(int64_t w, int64_t stride, const double *x, const double *y, double *sums) {
    for (int64_t i = 0; i < w; i++)
        for (int64_t j = i & ~(int64_t)3; j < stride; j++) sums[i * stride + j] += x[i] * x[j] + y[i] * y[j];
}

/* Sums over the corners of exposures, as `corner_sums` makes them.

   start (e + 1), counted from the first corner given; of corners: apart (m, 2) predicted minus detected, valid (m),
   by_point (m, 2, 3), by_parameters (m, 2, parameters), own (p) which of these; point, turned (3, m) in the camera's
   frame, with and without its origin, the latter over the scale; null where there is no column for it
   spread (m), sign (m, 2), R (e, 3, 3), number (m): null where not wanted
   out: sums (e, w, w), or (e, 2, w) where `single`; cost, square, count (e); each, weight (m); with `number` also
   by_twist (m, 6, 3), rest (w - 6, points, 3), squares (points, 3, 3), of corners that are counted */
CLONES EXPORT void gnomon_corner_sums(int64_t e, int64_t m, const int64_t *start, const double *apart,
                                      const uint8_t *valid, const double *by_point, const double *by_parameters,
                                      int64_t parameters, const int64_t *own, int64_t p, const double *point,
                                      const double *turned, double scale, const double *spread, const double *sign,
                                      double sigma, double huber, int64_t single, double *sums, double *cost,
                                      double *square, int64_t *count, double *each, double *weight, const double *R,
                                      const int64_t *number, const uint8_t *counted, int64_t points, double *by_twist,
                                      double *rest, double *squares) {
    const int64_t w = 6 + p + (turned ? 1 : 0) + 1 + (sign ? 1 : 0);
    const int64_t stride = (w + 3) & ~(int64_t)3;
    double columns[2][WIDTH] = {{0}}, upper[WIDTH * WIDTH];
    for (int64_t k = 0; k < e; k++) {
        double *gram = sums + k * (single ? 2 : w) * w, total = 0.0, squared = 0.0;
        int64_t seen = 0;
        memset(single ? gram : upper, 0, (size_t)(single ? 2 * w : w * stride) * sizeof(double));
        for (int64_t c = start[k]; c < start[k + 1]; c++) {
            each[c] = weight[c] = 0.0;
            if (number) memset(by_twist + 18 * c, 0, 18 * sizeof(double));
            if (!valid[c]) continue;
            const double sigma_px = spread ? sigma * spread[c] : sigma;
            const double off[2] = {apart[2 * c], apart[2 * c + 1]};
            const double length = off[0] * off[0] + off[1] * off[1], distance = sqrt(length) / sigma_px;
            const double robust = distance > huber ? huber / distance : 1.0, root = sqrt(robust) / sigma_px;
            each[c] = robust < 1 ? huber * (distance - 0.5 * huber) : 0.5 * distance * distance;
            weight[c] = robust;
            total += each[c], squared += length, seen++;
            const double x = point[c], y = point[m + c], z = point[2 * m + c];
            for (int i = 0; i < 2; i++) {
                const double *G = by_point + 6 * c + 3 * i;
                double *column = columns[i];
                column[0] = root * (G[2] * y - G[1] * z);
                column[1] = root * (G[0] * z - G[2] * x);
                column[2] = root * (G[1] * x - G[0] * y);
                for (int j = 0; j < 3; j++) column[3 + j] = root * G[j];
                for (int64_t j = 0; j < p; j++) column[6 + j] = root * by_parameters[(2 * c + i) * parameters + own[j]];
                int64_t next = 6 + p;
                if (turned)
                    column[next++] = root * (G[0] * turned[c] + G[1] * turned[m + c] + G[2] * turned[2 * m + c]) / scale;
                column[next++] = root * off[i];
                if (sign) column[next] = root * sign[2 * c + i] * sigma_px;
            }
            if (single)
                memcpy(gram, columns[0], (size_t)w * sizeof(double)),
                    memcpy(gram + w, columns[1], (size_t)w * sizeof(double));
            else
                add_products(w, stride, columns[0], columns[1], upper);
            if (number && counted[c]) {
                const int64_t at = number[c];
                double own_columns[2][3];
                for (int i = 0; i < 2; i++)
                    for (int j = 0; j < 3; j++) {
                        const double *G = by_point + 6 * c + 3 * i, *turn = R + 9 * k + j;
                        own_columns[i][j] = root * scale * (G[0] * turn[0] + G[1] * turn[3] + G[2] * turn[6]);
                    }
                for (int j = 0; j < 3; j++) {
                    const double a = own_columns[0][j], b = own_columns[1][j];
                    for (int i = 0; i < 6; i++) by_twist[18 * c + 3 * i + j] = columns[0][i] * a + columns[1][i] * b;
                    for (int64_t i = 6; i < w; i++)
                        rest[((i - 6) * points + at) * 3 + j] += columns[0][i] * a + columns[1][i] * b;
                    for (int i = 0; i < 3; i++)
                        squares[9 * at + 3 * i + j] += own_columns[0][i] * a + own_columns[1][i] * b;
                }
            }
        }
        for (int64_t i = 0; !single && i < w; i++)
            for (int64_t j = i; j < w; j++) gram[i * w + j] = gram[j * w + i] = upper[i * stride + j];
        cost[k] = total, count[k] = seen;
        square[k] = seen ? squared / (2.0 * (double)seen) : NAN;
    }
}

/* rotations from rates (estimate/multiposition/rotations.py) */

#define REGRESSORS 7 /* of a rate: the measured one, a one, the specific force */

static inline void hamilton(const double *a, const double *b, double *out) {
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

/* The quaternion of one step of RK4n from the rates at its ends, as in geometry/quaternion.py. */
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

/* running sums for Allan variances (estimate/allan/deviation.py) */

/* The sums of three axes (n, 3) about given values, which lie among them. */
CLONES EXPORT void gnomon_sums(int64_t n, const double *y, const double *about, double *sum) {
    double lanes[12] = {0.0}, middle[12];
    for (int j = 0; j < 12; j++) middle[j] = about[j % 3];
    for (int64_t k = 0; k + 4 <= n; k += 4)
        for (int j = 0; j < 12; j++) lanes[j] += y[3 * k + j] - middle[j];
    for (int64_t k = n / 4 * 4; k < n; k++)
        for (int i = 0; i < 3; i++) lanes[i] += y[3 * k + i] - middle[i];
    for (int i = 0; i < 3; i++) sum[i] = lanes[i] + lanes[3 + i] + lanes[6 + i] + lanes[9 + i];
}

/* The running sums (3, n) of three axes (n, 3) about means, beyond what came before; the rows of x are `row` apart. */
CLONES EXPORT void gnomon_running_sums(int64_t n, const double *y, const double *mean, const double *before,
                                       int64_t row, double *x) {
    double *const axes[3] = {x, x + row, x + 2 * row};
    double sum[3] = {before[0], before[1], before[2]};
    for (int64_t k = 0; k < n; k++)
        for (int i = 0; i < 3; i++) axes[i][k] = sum[i] += y[3 * k + i] - mean[i];
}

#define LANES 16     /* sums that are added up beside each other */
#define STRETCH 2048 /* of a running sum, which stays in the nearest memory for all lags */

INLINE double product(int64_t n, const double *a, const double *b) {
    double lanes[LANES] = {0.0}, sum = 0.0;
    const int64_t whole = n - n % LANES;
    for (int64_t k = 0; k < whole; k += LANES)
        for (int j = 0; j < LANES; j++) lanes[j] += a[k + j] * b[k + j];
    for (int64_t k = whole; k < n; k++) lanes[0] += a[k] * b[k];
    for (int j = 0; j < LANES; j++) sum += lanes[j];
    return sum;
}

INLINE double total(int64_t n, const double *a) {
    double lanes[LANES] = {0.0}, sum = 0.0;
    const int64_t whole = n - n % LANES;
    for (int64_t k = 0; k < whole; k += LANES)
        for (int j = 0; j < LANES; j++) lanes[j] += a[k + j];
    for (int64_t k = whole; k < n; k++) lanes[0] += a[k];
    for (int j = 0; j < LANES; j++) sum += lanes[j];
    return sum;
}

/* Products of a running sum x (n) with the values 1, 2, 4, ... places later (levels + 1), its square and its sum (2),
   and what stands at its ends (8, levels). */
CLONES EXPORT void gnomon_lagged_products(int64_t n, const double *x, int64_t levels, double *lagged, double *whole,
                                          double *ends) {
    static const int rows[2][4] = {{0, 1, 4, 6}, {3, 2, 5, 7}};
    memset(lagged, 0, (levels + 1) * sizeof(double)), whole[0] = whole[1] = 0.0;
    for (int64_t start = 0; start < n; start += STRETCH) {
        const int64_t length = n - start < STRETCH ? n - start : STRETCH;
        whole[0] += product(length, x + start, x + start), whole[1] += total(length, x + start);
        for (int64_t k = 0; k <= levels; k++) {
            const int64_t lag = (int64_t)1 << k, left = n - start - lag;
            if (left > 0) lagged[k] += product(left < length ? left : length, x + start, x + start + lag);
        }
    }
    for (int last = 0; last < 2; last++) {
        double sum = x[last ? n - 1 : 0], square = sum * sum;
        for (int64_t k = 0; k < levels; k++) {
            const int64_t m = (int64_t)1 << k;
            const double *near = last ? x + n - m : x, *far = last ? near - m : x + m;
            double both = 0.0, far_square = 0.0, far_sum = 0.0;
            for (int64_t start = 0; start < m; start += STRETCH) {
                const int64_t length = m - start < STRETCH ? m - start : STRETCH;
                both += product(length, near + start, far + start);
                far_square += product(length, far + start, far + start), far_sum += total(length, far + start);
            }
            const double found[4] = {square, far_square, both, sum - far_sum};
            for (int i = 0; i < 4; i++) ends[rows[last][i] * levels + k] = found[i];
            square += far_square, sum += far_sum;
        }
    }
}

/* fits of corners (detect/corners/corner_fit.py), in single precision pixel by pixel, as there */

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

/* tables (writers/apply.py) */

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
