/* Bias compensation of a ring laser gyro; see simulated_unit_2.h. Written by rlgcomp 0.1.0; do not edit. */
#include "simulated_unit_2.h"


#ifdef __FAST_MATH__
#error "-ffast-math removes the checks for samples that are not finite; compile without it"
#endif

typedef simulated_unit_2_real real;

enum { INPUTS = SIMULATED_UNIT_2_INPUTS };

/* Training range; beyond it a sample is flagged, and the half width grows with each span. */
static const real LOW[INPUTS] = { -40.85590921350921, -19.176379406269607, -0.9294913770819141, -4.942325954501438, -14.240176817040695, -33.97874835966984, -5.390000000000002, -10.670000000000003, -20.9, 0.9860943851647213, -0.01379032769250977 };
static const real HIGH[INPUTS] = { 65.89946616370715, 19.212574666732603, 1.00213378992496, 4.5591174216839985, 12.804468866338823, 28.820228547028375, 5.390000000000002, 10.670000000000003, 20.900000000000002, 1.057954204826908, 0.05578560972396244 };
static const real PER_SPAN[INPUTS] = { 0.009367209814649008, 0.026049159820774322, 0.5176987839465447, 0.10524716723633962, 0.036975895772765006, 0.015923826298726514, 0.09276437847866416, 0.04686035613870664, 0.023923444976076555, 13.915982599191095, 14.372785148608699 };
/* Where inputs are clipped. */
static const real LEAST[INPUTS] = { -40.85590921350921, -19.176379406269607, -0.9294913770819141, -4.942325954501438, -14.240176817040695, -33.97874835966984, -5.390000000000002, -10.670000000000003, -20.9, 0.9860943851647213, -0.01379032769250977 };
static const real MOST[INPUTS] = { 65.89946616370715, 19.212574666732603, 1.00213378992496, 4.5591174216839985, 12.804468866338823, 28.820228547028375, 5.390000000000002, 10.670000000000003, 20.900000000000002, 1.057954204826908, 0.05578560972396244 };
/* Scaling: (input - OFFSET) * PER_SCALE. */
static const real OFFSET[INPUTS] = { 12.519742248375152, 0.019217157835240917, 0.03690491756962758, -0.19277697104394353, -0.7166982504695891, -2.5820799238386396, 2.7755575615628914e-17, -9.159339953157541e-16, -1.3322676295501878e-15, 1.022133381679717, 0.020706073371822738 };
static const real PER_SCALE[INPUTS] = { 0.020611902016618992, 0.057356696013163184, 1.1483030095058278, 0.23205955121392172, 0.08140503941413711, 0.03504780736719395, 0.2040816326530612, 0.1030927835051546, 0.05263157894736842, 31.265993295429176, 32.562380314383546 };

static const real POWERS[3][INPUTS] = {
    { 0.49501410424281306, 2.431564405355521, 4.848124220095018, 2.539823968725975, -1.0560315737692454, 0.3279000315743372, 0.007541485653728967, 0.061313195454632194, 0.0717674632828317, 0.22199711679572212, 2.4440348601896043 },
    { 0.23333747836923832, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.0022083752139450295, -0.10679476292088975 },
    { 7.559398414485465e-05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.03483205983299171, -0.09849950843721313 },
};

/* Infinity and NaN less themselves are NaN. */
#define IS_FINITE(value) ((value) - (value) == 0)

/* Bias in deg/h of the model's inputs. *outside becomes by how many spans of its training range inputs lie beyond it, summed, and
 * *flagged 1 where one does. */
static real bias_of(const real inputs[INPUTS], real *outside, int *flagged)
{
    real x[INPUTS];
    real v;
    int j;

    for (j = 0; j < INPUTS; ++j) {
        real clipped = inputs[j];

        if (clipped < LOW[j]) {
            *flagged = 1;
            *outside += (LOW[j] - clipped) * PER_SPAN[j];
        } else if (clipped > HIGH[j]) {
            *flagged = 1;
            *outside += (clipped - HIGH[j]) * PER_SPAN[j];
        }
        clipped = clipped < LEAST[j] ? LEAST[j] : clipped;
        clipped = clipped > MOST[j] ? MOST[j] : clipped;
        x[j] = (clipped - OFFSET[j]) * PER_SCALE[j];
    }
    v = 0.9904454856625317;
    for (j = 0; j < INPUTS; ++j) {
        v += x[j] * (POWERS[0][j] + x[j] * (POWERS[1][j] + x[j] * (POWERS[2][j])));
    }
    return 0.021683201257751094 + 0.013621860517542309 * v;
}

/* First-order low-pass filter by the backward Euler rule: how far its output is behind the monitor after this step. */
static real behind(real *state, real monitor, real step_s, real time_constant_s)
{
    const real share = step_s > 0 ? step_s / (time_constant_s + step_s) : 0;
    state[0] = state[0] + share * (monitor - state[0]);
    return state[0] - monitor;
}

/* Play operator: where it has been left, relative to the monitor. */
static real left_behind(real *state, real monitor, real radius)
{
    if (*state < monitor - radius) {
        *state = monitor - radius;
    } else if (*state > monitor + radius) {
        *state = monitor + radius;
    }
    return *state - monitor;
}

void simulated_unit_2_init(simulated_unit_2_state *state)
{
    int slot;

    for (slot = 0; slot < 7; ++slot) {
        state->memory[slot] = 0;
    }
    state->time_s = 0;
    state->bias_deg_h = 0.021683201257751094;
    state->half_width_deg_h = 0.0753086562379164;
    state->started = 0;
}

static int answer(const simulated_unit_2_state *state, int status, simulated_unit_2_result *result)
{
    result->bias_deg_h = state->bias_deg_h;
    result->half_width_deg_h = state->half_width_deg_h;
    result->correction_deg_h = state->bias_deg_h - 0.0;
    result->status = status;
    return status;
}

double simulated_unit_2_correct_deg_h(double gyro, const simulated_unit_2_result *result)
{
    return gyro - (double)result->correction_deg_h;
}

int simulated_unit_2_step(simulated_unit_2_state *state, double time_s, const simulated_unit_2_real monitors[SIMULATED_UNIT_2_MONITORS], simulated_unit_2_result *result)
{
    simulated_unit_2_state next = *state; /* kept once the sample is known to be valid */
    real inputs[INPUTS];
    real step_s;
    real outside = 0;
    int k, flagged = 0, valid = IS_FINITE(time_s) && !(state->started && time_s <= state->time_s);

    for (k = 0; k < SIMULATED_UNIT_2_MONITORS; ++k) {
        valid = valid && IS_FINITE(monitors[k]);
    }
    if (!valid) {
        return answer(state, SIMULATED_UNIT_2_INVALID, result);
    }
    if (!next.started) {
        next.started = 1;
        next.time_s = time_s;
        next.memory[0] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[1] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[2] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[3] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[4] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[5] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
        next.memory[6] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
    }
    step_s = (real)(time_s - next.time_s);
    next.time_s = time_s;

    inputs[0] = monitors[SIMULATED_UNIT_2_temperature_block_degC];
    inputs[1] = monitors[SIMULATED_UNIT_2_temperature_block_degC] - monitors[SIMULATED_UNIT_2_temperature_shell_degC];
    inputs[2] = -1.0 * behind(&next.memory[0], monitors[SIMULATED_UNIT_2_temperature_block_degC], step_s, 60.0);
    inputs[3] = behind(&next.memory[1], monitors[SIMULATED_UNIT_2_temperature_block_degC], step_s, 300.0);
    inputs[4] = behind(&next.memory[2], monitors[SIMULATED_UNIT_2_temperature_block_degC], step_s, 900.0);
    inputs[5] = behind(&next.memory[3], monitors[SIMULATED_UNIT_2_temperature_block_degC], step_s, 2700.0);
    inputs[6] = left_behind(&next.memory[4], monitors[SIMULATED_UNIT_2_temperature_block_degC], 4.9);
    inputs[7] = left_behind(&next.memory[5], monitors[SIMULATED_UNIT_2_temperature_block_degC], 9.7);
    inputs[8] = left_behind(&next.memory[6], monitors[SIMULATED_UNIT_2_temperature_block_degC], 19.0);
    inputs[9] = monitors[SIMULATED_UNIT_2_light_intensity_V];
    inputs[10] = (monitors[SIMULATED_UNIT_2_readout_a_V] - monitors[SIMULATED_UNIT_2_readout_b_V]) / (monitors[SIMULATED_UNIT_2_readout_a_V] + monitors[SIMULATED_UNIT_2_readout_b_V]);

    for (k = 0; k < INPUTS; ++k) {
        if (!IS_FINITE(inputs[k])) {
            return answer(state, SIMULATED_UNIT_2_INVALID, result);
        }
    }
    next.bias_deg_h = bias_of(inputs, &outside, &flagged);
    next.half_width_deg_h = 0.0032696952056032037 + 0.0753086562379164 * outside;
    *state = next;
    return answer(state, flagged ? SIMULATED_UNIT_2_OUT_OF_RANGE : SIMULATED_UNIT_2_OK, result);
}
