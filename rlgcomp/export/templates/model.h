/* Bias compensation of a ring laser gyro. Written by rlgcomp {{ version }}; do not edit.
 *
 * model       {{ model }}, SHA-256 {{ sha256 }}
 * kind        {{ kind }}
 * gyro        {{ gyro }}; unit {{ unit }}
{% if calibration %}
 * gyro input  calibrated with the file of SHA-256 {{ calibration }}
{% endif %}
 * trained on  {{ rows }} means over {{ averaging_s }} s from {{ runs }} run{{ "" if runs == 1 else "s" }}
 * tables      {{ e.centres|length }} of the model's {{ centres_of_model }} centres x {{ e.features }} inputs, {{ real }}, {{ table_bytes }} bytes
 * needs       C99, {{ "sqrt of the C library" if form == "matern" and libm else "no library" }}; not -ffast-math
 *
 * Call {{ p }}_init once after switching on,
 * then {{ p }}_step for every sample, in order. One state serves one gyro;
 * there is no other memory and nothing is allocated. Subtract correction_deg_h from the gyro's rate, or let
 * {{ p }}_correct_deg_h do it.
 *
 * {{ P }}_OUT_OF_RANGE: an input is beyond its training range; further out it is clipped to where the model still answers, so the output
 * stays bounded.
 * {{ P }}_INVALID: the sample is not finite, gives no finite input ({{ "readouts whose sum is 0, " if dark else "" }}numbers too large), or is not later
 * than the one before, or more than {{ longest_step_s }} s later. It changes no estimate, and the result repeats the last valid one. A
 * step of time that is longer is believed from the second sample on, a clock that was set back from the fourth on, if they follow each other; before any, the training mean with a half width of
 * {{ "%.3g"|format(interval.per_span_deg_h) }} deg/h, the bias's span in training.
 * Whatever else is finite is believed: filters and hysteresis follow a monitor's single wild sample too, and take as long to forget
 * it as they remember. Keep such samples from {{ p }}_step where the converter shows them.
 */
#ifndef {{ P }}_H
#define {{ P }}_H

#ifdef __cplusplus
extern "C" {
#endif

typedef {{ real }} {{ p }}_real;

#define {{ P }}_MODEL_SHA256 "{{ sha256 }}"

/* Monitors, in the order in which {{ p }}_step takes them. */
enum {
{% for name, comment in monitors %}
    {{ P }}_{{ name }} = {{ loop.index0 }}, /* {{ comment }} */
{% endfor %}
    {{ P }}_MONITORS = {{ monitors|length }}
};

/* Inputs of the model:
{% for name, low, high in inputs %}
 *   {{ name }}, trained from {{ low }} to {{ high }}
{% endfor %}
 */
#define {{ P }}_INPUTS {{ e.features }}
#define {{ P }}_CENTRES {{ e.centres|length }}
{% if physics %}
/* Known physics, whose range does not count:
{% for name in physics %}
 *   {{ name }}
{% endfor %}
 */
#define {{ P }}_TERMS {{ physics|length }}
{% endif %}

enum { {{ P }}_OK = 0, {{ P }}_OUT_OF_RANGE = 1, {{ P }}_INVALID = 2 };

typedef struct {
    double time_s;            /* of the last valid sample */
    {{ p }}_real bias_deg_h;  /* what was last answered */
    {{ p }}_real half_width_deg_h;
{% if slots %}
    {{ p }}_real memory[{{ slots }}]; /* filters and hysteresis, in the monitors' units */
{% endif %}
{% if offset_s %}
    double offset_begin_s; /* of {{ p }}_step_zeroed: when the recording began, */
    double offset_total_deg_h; /* sum of gyro less bias over its first {{ "%g"|format(offset_s) }} s, */
    int offset_count;          /* of how many samples, */
    int offset_over;           /* and whether they are over */
{% endif %}
    double refused_s; /* time of the last sample that came too far ahead or not later */
    int refused;      /* how many of these followed each other */
    int started;
{% if relays %}
    unsigned char relays[{{ relays }}]; /* hysteresis and hops: which are on */
{% endif %}
} {{ p }}_state;

typedef struct {
    {{ p }}_real bias_deg_h;       /* estimated bias, deg/h */
    {{ p }}_real correction_deg_h; /* what to subtract from the gyro, deg/h{{ "; its training mean stays in" if e.reference_deg_h else "" }} */
    {{ p }}_real half_width_deg_h; /* {{ coverage }} of the means over {{ averaging_s }} s lie within this of the bias */
    int status;                    /* as returned */
} {{ p }}_result;

/* Begin a recording: forget everything. */
void {{ p }}_init({{ p }}_state *state);

/* Take one sample: its time in s, a double in every precision, and its monitors. Returns the status. */
int {{ p }}_step({{ p }}_state *state, double time_s, const {{ p }}_real monitors[{{ P }}_MONITORS], {{ p }}_result *result);

{% if offset_s %}
/* As {{ p }}_step, less the offset of this recording: the mean of the gyro's rate less the estimated bias over the first {{ "%g"|format(offset_s) }} s,
 * and until they are over the mean so far. The gyro must be at rest then, and Earth rate removed. A gyro that is not finite makes
 * the sample {{ P }}_INVALID. Use it for every sample of a recording, or for none. */
int {{ p }}_step_zeroed({{ p }}_state *state, double time_s, const {{ p }}_real monitors[{{ P }}_MONITORS], {{ gyro_arguments }},
    {{ p }}_result *result);

{% endif %}
/* Corrected rate in deg/h of one sample of {{ gyro }} as it comes{{ ", in " ~ gyro_unit if not pulses else ": signed pulses in period_s seconds" }}. */
{{ correct }};

#ifdef __cplusplus
}
#endif

#endif
