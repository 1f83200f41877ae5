/* Self-test of {{ p }}.c: streams a golden recording and compares with what Python computed. Written by rlgcomp {{ version }}.
 *
 *   {{ p }}_selftest           the golden recording; exit 0 where every sample agrees
 *   {{ p }}_selftest stream    samples from standard input, "time_s monitor ...{{ " rate_deg_h" if offset_s }}" a line; "status bias half_width" a line comes out
 *   {{ p }}_selftest time      nanoseconds a step
 */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

#include "{{ p }}.h"

enum { ROWS = {{ golden|length }}, BIAS = {{ 2 if offset_s else 1 }} + {{ P }}_MONITORS, WIDTH = BIAS + 1, ALLOWED = BIAS + 2, WIDTH_ALLOWED = BIAS + 3, STATUS = BIAS + 4 };

/* time_s, monitors{{ ", rate of the gyro in deg/h" if offset_s }}; bias and half width, the differences allowed in both, in deg/h; status, of which -1 stands for OK or
 * OUT_OF_RANGE, too near to decide. */
static const double GOLDEN[ROWS][STATUS + 1] = {
{% for values in golden %}
    { {{ values|join(", ") }} },
{% endfor %}
};

static int step({{ p }}_state *state, const double sample[BIAS], {{ p }}_result *result)
{
    {{ p }}_real monitors[{{ P }}_MONITORS];
    int k;

    for (k = 0; k < {{ P }}_MONITORS; ++k) {
        monitors[k] = ({{ p }}_real)sample[1 + k];
    }
{% if offset_s %}
    return {{ p }}_step_zeroed(state, sample[0], monitors, {{ gyro_of_rate }}, result);
{% else %}
    return {{ p }}_step(state, sample[0], monitors, result);
{% endif %}
}

static int golden(void)
{
    {{ p }}_state state;
    {{ p }}_result result;
    double within = 0.0, share = 0.0;
    int row, wrong = 0;

    {{ p }}_init(&state);
    for (row = 0; row < ROWS; ++row) {
        const int status = step(&state, GOLDEN[row], &result);
        const double difference = fabs((double)result.bias_deg_h - GOLDEN[row][BIAS]);
        const double wider = fabs((double)result.half_width_deg_h - GOLDEN[row][WIDTH]);
        const int expected = (int)GOLDEN[row][STATUS];

        within = difference > within && status == {{ P }}_OK ? difference : within;
        share = difference / GOLDEN[row][ALLOWED] > share ? difference / GOLDEN[row][ALLOWED] : share;
        if (!(difference <= GOLDEN[row][ALLOWED]) || !(wider <= GOLDEN[row][WIDTH_ALLOWED])
            || (expected < 0 ? status == {{ P }}_INVALID : status != expected)) {
            ++wrong;
        }
    }
    printf("%d samples, %d wrong; largest difference %.3g deg/h within range, %.3g of what is allowed anywhere; state %u bytes: %s\n",
           ROWS, wrong, within, share, (unsigned)sizeof state, wrong ? "FAIL" : "PASS");
    return wrong != 0;
}

static int stream(void)
{
    {{ p }}_state state;
    {{ p }}_result result;
    double sample[BIAS];

    {{ p }}_init(&state);
    for (;;) {
        int k, status;

        for (k = 0; k < BIAS; ++k) {
            if (scanf("%lf", &sample[k]) != 1) {
                return k != 0;
            }
        }
        status = step(&state, sample, &result);
        printf("%d %.17g %.17g\n", status, (double)result.bias_deg_h, (double)result.half_width_deg_h);
    }
}

static int timing(void)
{
    {{ p }}_state state;
    {{ p }}_result result;
    double best_ns = 1e99, kept = 0.0;
    int trial, pass, row;

    for (trial = 0; trial < 20; ++trial) {
        const int passes = {{ passes }};
        const clock_t begun = clock();
        double ns;

        for (pass = 0; pass < passes; ++pass) {
            {{ p }}_init(&state);
            for (row = 1; row <= {{ quiet_rows }}; ++row) {
                (void)step(&state, GOLDEN[row], &result);
                kept += (double)result.bias_deg_h;
            }
        }
        ns = 1e9 * (double)(clock() - begun) / CLOCKS_PER_SEC / passes / {{ quiet_rows }};
        best_ns = ns < best_ns ? ns : best_ns;
    }
    printf("%.1f ns a step\n", best_ns);
    return !(kept - kept == 0.0);
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "stream") == 0) {
        return stream();
    }
    if (argc > 1 && strcmp(argv[1], "time") == 0) {
        return timing();
    }
    return golden();
}
