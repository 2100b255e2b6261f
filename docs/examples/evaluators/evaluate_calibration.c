/* Evaluates a calibration (docs/model.md) whose numbers were written one a line by

     jq -r '[.image.width, (if .image.mirrored then 1 else 0 end),
             (["perspective", "equidistant", "equisolid", "stereographic", "orthographic"] | index($p)),
             .model.focal_length_px, .model.skew_px, .model.principal_point_px, .model.rotation_cam_enu,
             .model.translation, .model.radial, .model.decentering, .model.max_angle_deg,
             .backward_model.radial, .backward_model.decentering,
             (.uncertainty.field | .center_px, .half_px, (.orders | length), .orders, .mean),
             (.uncertainty.mixture // {shares: [1], pixels_px: [[0, 0]], scales: [[1]]} |
              (.shares | length), (.pixels_px | length), .shares, .pixels_px, .scales)] | flatten[]' \
        --arg p "$(jq -r .model.projection calibration.json)" calibration.json > calibration.txt

   cc -O2 evaluate_calibration.c -lm -o evaluate && ./evaluate calibration.txt < questions
   p X Y is answered with east north up, d EAST NORTH UP with x y, and h X Y SHARE with the stated sigmas within which a
   share (0.5, 0.95) of the errors at a pixel lies. */
#include <math.h>
#include <stdio.h>

static double n[9000]; /* width mirrored projection fx fy s x0 y0 w3 t3 k2..k9 p1..p4 max b2..b9 q1..q5 box4 m field mixture */
enum { F = 3, SKEW = 5, CENTER = 6, ROTATION = 8, SHIFT = 11, RADIAL = 14, P = 22, MOST = 26, BACK = 27, Q = 35 };
enum { BOX = 40, WAVES = 44, ORDERS = 45, MOST_CLASSES = 16 }; /* centre and half-widths; how many; their orders, and both components */
static int mixture;    /* where its numbers begin: how many classes and places, shares, pixels, scales */
static double R[3][3]; /* east-north-up to camera */

static double ideal(double x, int inverse) { /* radius of an angle, or angle of a radius */
    switch ((int)n[2]) {
    case 0: return inverse ? atan(x) : tan(x);
    case 1: return x;
    case 2: return inverse ? 2 * asin(x / 2) : 2 * sin(x / 2);
    case 3: return inverse ? 2 * atan(x / 2) : 2 * tan(x / 2);
    default: return inverse ? asin(x) : sin(x);
    }
}

static double polynomial(const double *k, double x) { /* k2 x^2 + ... + k9 x^9 */
    double sum = 0;
    for (int i = 7; i >= 0; i--) sum = sum * x + k[i];
    return sum * x * x;
}

static void decenter(const double *c, int higher, double r, double x, double y, double *d) {
    double u = r > 0 ? x / r : 1, v = r > 0 ? y / r : 0, g = 0;
    for (int i = higher; i >= 1; i--) g = (g + c[1 + i]) * r * r;
    g = (1 + g) * r * r;
    d[0] = g * (c[0] * (1 + 2 * u * u) + 2 * c[1] * u * v);
    d[1] = g * (2 * c[0] * u * v + c[1] * (1 + 2 * v * v));
}

static void rotate(void) { /* of the rotation vector (Rodrigues) */
    const double *w = n + ROTATION, angle = hypot(hypot(w[0], w[1]), w[2]), s = angle > 0 ? angle : 1;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            R[i][j] = (i == j) * cos(angle) + (1 - cos(angle)) * w[i] * w[j] / (s * s) +
                      (i == j ? 0 : ((j - i + 3) % 3 == 1 ? -1 : 1) * sin(angle) * w[3 - i - j] / s);
}

static void field(const double *pixel, double *d) { /* displacement of a pixel; 0 beyond the box */
    int m = (int)n[WAVES];
    double u = (pixel[0] - n[BOX]) / n[BOX + 2] + 1, v = (pixel[1] - n[BOX + 1]) / n[BOX + 3] + 1, half = acos(-1) / 2;
    d[0] = d[1] = 0;
    for (int j = 0; j < m && u > 0 && u < 2 && v > 0 && v < 2; j++) {
        const double *order = n + ORDERS + 2 * j;
        double wave = sin(half * order[0] * u) * sin(half * order[1] * v) / sqrt(n[BOX + 2] * n[BOX + 3]);
        for (int i = 0; i < 2; i++) d[i] += wave * n[ORDERS + (2 + i) * m + j];
    }
}

static void project(const double *d, double *pixel) {
    double ray[3], e[2];
    for (int i = 0; i < 3; i++) ray[i] = R[i][0] * d[0] + R[i][1] * d[1] + R[i][2] * d[2] + n[SHIFT + i];
    double across = hypot(ray[0], ray[1]), theta = atan2(across, ray[2]), half = acos(-1) / 2;
    double r = ideal(theta, 0) + polynomial(n + RADIAL, theta / half), q = across > 0 ? r / across : 0;
    decenter(n + P, 2, r, q * ray[0], q * ray[1], e);
    double x = q * ray[0] + e[0], y = q * ray[1] + e[1], px = n[F] * x + n[SKEW] * y + n[CENTER];
    pixel[0] = theta > n[MOST] * half / 90 ? NAN : n[1] ? n[0] - 1 - px : px;
    pixel[1] = theta > n[MOST] * half / 90 ? NAN : n[F + 1] * y + n[CENTER + 1];
    field(pixel, e);
    pixel[0] += e[0], pixel[1] += e[1];
}

static void back_project(const double *seen, double *d) { /* closed form */
    double e[2], pixel[2] = {seen[0], seen[1]};
    for (int i = 0; i < 8; i++) field(pixel, e), pixel[0] = seen[0] - e[0], pixel[1] = seen[1] - e[1];
    double px = n[1] ? n[0] - 1 - pixel[0] : pixel[0];
    double y = (pixel[1] - n[CENTER + 1]) / n[F + 1], x = (px - n[CENTER] - n[SKEW] * y) / n[F], r = hypot(x, y);
    decenter(n + Q, 3, r, x, y, e);
    double adjusted = hypot(x - e[0], y - e[1]), theta = ideal(adjusted - polynomial(n + BACK, r), 1);
    double s = adjusted > 0 ? sin(theta) / adjusted : 0, ray[3] = {s * (x - e[0]), s * (y - e[1]), cos(theta)};
    for (int i = 0; i < 3; i++) d[i] = R[0][i] * ray[0] + R[1][i] * ray[1] + R[2][i] * ray[2];
}

static double holding(const double *pixel, double share) { /* sigmas, by Newton's method: what is outside is convex */
    int classes = (int)n[mixture], places = (int)n[mixture + 1];
    const double *shares = n + mixture + 2, *at = shares + classes, *scales = at + 2 * places;
    double total = 0, t = 0, s[MOST_CLASSES] = {0};
    for (int j = 0; j < places; j++, at += 2, scales += classes) {
        double u = pow(1 + pow(pixel[0] - at[0], 2) + pow(pixel[1] - at[1], 2), -2);
        total += u;
        for (int k = 0; k < classes; k++) s[k] += u * scales[k];
    }
    for (int round = 0; round < 60; round++) {
        double outside = 0, slope = 0;
        for (int k = 0; k < classes; k++) {
            double rate = total * total / (2 * s[k] * s[k]), part = shares[k] * exp(-t * rate);
            outside += part, slope += part * rate;
        }
        t += outside * log(outside / (1 - share)) / slope;
    }
    return sqrt(t);
}

int main(int count, char **names) {
    FILE *file = count == 2 ? fopen(names[1], "r") : NULL;
    double in[3], out[3];
    char kind;
    for (int i = 0, end = ORDERS; i < end; i++) {
        if (i >= 9000 || !file || fscanf(file, "%lf", n + i) != 1) return fprintf(stderr, "no such file\n"), 2;
        if (i == WAVES) mixture = ORDERS + 4 * (int)n[WAVES], end = mixture + 2;
        if (mixture && i == mixture + 1) end += (int)(n[mixture] + n[i] * (2 + n[mixture]));
    }
    if (n[mixture] > MOST_CLASSES) return fprintf(stderr, "too many classes\n"), 2;
    rotate();
    while (scanf(" %c %lf %lf", &kind, in, in + 1) == 3)
        if (kind == 'p') back_project(in, out), printf("%.17g %.17g %.17g\n", out[0], out[1], out[2]);
        else if (scanf("%lf", in + 2) == 1 && kind == 'h') printf("%.17g\n", holding(in, in[2]));
        else project(in, out), printf("%.17g %.17g\n", out[0], out[1]);
    return 0;
}
