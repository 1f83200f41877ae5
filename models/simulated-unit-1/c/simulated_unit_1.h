/* Bias compensation of a ring laser gyro. Written by rlgcomp 0.1.0; do not edit.
 *
 * model       simulated_unit_1, SHA-256 bd68352286155eb26f2c524a086a188fbc4c5044810af756dd3f47dd3f840bc8
 * kind        LSSVMRegressor(c = 100000.0, degree = 3, kernel = gaussian, offset = 1.0, robust = False, sigma = 212.2639865827456, slope = 0.01), as Gaussian kernel with its first three orders summed beforehand
 * gyro        gyro_deg_h; unit simulated-1
 * trained on  816 means over 100 s from 2 runs
 * tables      816 of the model's 816 centres x 11 inputs, double, 79568 bytes
 * needs       C99, no library; not -ffast-math
 *
 * Call simulated_unit_1_init once after switching on,
 * then simulated_unit_1_step for every sample, in order. One state serves one gyro;
 * there is no other memory and nothing is allocated. Subtract correction_deg_h from the gyro's rate, or let
 * simulated_unit_1_correct_deg_h do it.
 *
 * SIMULATED_UNIT_1_OUT_OF_RANGE: an input is beyond its training range; further out it is clipped to where the model still answers, so the output
 * stays bounded.
 * SIMULATED_UNIT_1_INVALID: the sample is not finite, gives no finite input (readouts whose sum is 0, numbers too large), or is not later
 * than the one before. It changes nothing, and the result repeats the last valid one; before any, the training mean with a half width of
 * 0.0605 deg/h, the bias's span in training.
 * Whatever else is finite is believed: filters and hysteresis follow a monitor's single wild sample too, and take as long to forget
 * it as they remember. Keep such samples from simulated_unit_1_step where the converter shows them.
 */
#ifndef SIMULATED_UNIT_1_H
#define SIMULATED_UNIT_1_H

#ifdef __cplusplus
extern "C" {
#endif

typedef double simulated_unit_1_real;

#define SIMULATED_UNIT_1_MODEL_SHA256 "bd68352286155eb26f2c524a086a188fbc4c5044810af756dd3f47dd3f840bc8"

/* Monitors, in the order in which simulated_unit_1_step takes them. */
enum {
    SIMULATED_UNIT_1_temperature_block_degC = 0, /* temperature_block_degC, in degC */
    SIMULATED_UNIT_1_temperature_shell_degC = 1, /* temperature_shell_degC, in degC */
    SIMULATED_UNIT_1_light_intensity_V = 2, /* light_intensity_V, in V */
    SIMULATED_UNIT_1_readout_a_V = 3, /* readout_a_V, in V */
    SIMULATED_UNIT_1_readout_b_V = 4, /* readout_b_V, in V */
    SIMULATED_UNIT_1_MONITORS = 5
};

/* Inputs of the model:
 *   temperature_block_degC, trained from -40.8559 to 65.8995
 *   temperature_block_minus_temperature_shell_K, trained from -19.1764 to 19.2126
 *   temperature_block_rate_degC_min, trained from -0.929491 to 1.00213
 *   temperature_block_lag_300s_K, trained from -4.94233 to 4.55912
 *   temperature_block_lag_900s_K, trained from -14.2402 to 12.8045
 *   temperature_block_lag_2700s_K, trained from -33.9787 to 28.8202
 *   temperature_block_memory_4.9_K, trained from -5.39 to 5.39
 *   temperature_block_memory_9.7_K, trained from -10.67 to 10.67
 *   temperature_block_memory_19_K, trained from -20.9 to 20.9
 *   light_intensity_V, trained from 0.971306 to 1.01595
 *   readout_difference, trained from -0.0175923 to 0.039162
 */
#define SIMULATED_UNIT_1_INPUTS 11
#define SIMULATED_UNIT_1_CENTRES 816

enum { SIMULATED_UNIT_1_OK = 0, SIMULATED_UNIT_1_OUT_OF_RANGE = 1, SIMULATED_UNIT_1_INVALID = 2 };

typedef struct {
    double time_s;            /* of the last valid sample */
    simulated_unit_1_real bias_deg_h;  /* what was last answered */
    simulated_unit_1_real half_width_deg_h;
    simulated_unit_1_real memory[7]; /* filters and hysteresis, in the monitors' units */
    int started;
} simulated_unit_1_state;

typedef struct {
    simulated_unit_1_real bias_deg_h;       /* estimated bias, deg/h */
    simulated_unit_1_real correction_deg_h; /* what to subtract from the gyro, deg/h */
    simulated_unit_1_real half_width_deg_h; /* 90 % of the means over 100 s lie within this of the bias */
    int status;                    /* as returned */
} simulated_unit_1_result;

/* Begin a recording: forget everything. */
void simulated_unit_1_init(simulated_unit_1_state *state);

/* Take one sample: its time in s, a double in every precision, and its monitors. Returns the status. */
int simulated_unit_1_step(simulated_unit_1_state *state, double time_s, const simulated_unit_1_real monitors[SIMULATED_UNIT_1_MONITORS], simulated_unit_1_result *result);

/* Corrected rate in deg/h of one sample of gyro_deg_h as it comes, in deg/h. */
double simulated_unit_1_correct_deg_h(double gyro, const simulated_unit_1_result *result);

#ifdef __cplusplus
}
#endif

#endif
