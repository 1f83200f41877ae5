/* Bias compensation of a ring laser gyro; see {{ p }}.h. Written by rlgcomp {{ version }}; do not edit. */
#include "{{ p }}.h"

{% if (form == "matern" and libm) or "cosine" in helpers %}
#include <math.h>
{% endif %}
{% if exponentials %}
#include <stdint.h>
#include <string.h>
{% endif %}

#ifdef __FAST_MATH__
#error "-ffast-math removes the checks for samples that are not finite; compile without it"
#endif

typedef {{ p }}_real real;

enum { INPUTS = {{ P }}_INPUTS{% if physics %}, TERMS = {{ P }}_TERMS{% endif %}{% if blocks %}, LANES = {{ lanes }}, BLOCKS = {{ blocks }}{% endif %} };

/* A step of time that is longer is believed only if the next sample follows it. */
static const double LONGEST_STEP_S = {{ longest_step_s }}.0;

/* Training range; beyond it a sample is flagged, and the half width grows with each span. */
static const real LOW[INPUTS] = { {{ listed(e.low) }} };
static const real HIGH[INPUTS] = { {{ listed(e.high) }} };
static const real PER_SPAN[INPUTS] = { {{ listed(1.0 / spans) }} };
/* Where inputs are clipped. */
static const real LEAST[INPUTS] = { {{ listed(e.least) }} };
static const real MOST[INPUTS] = { {{ listed(e.most) }} };
/* Scaling: (input - OFFSET) * PER_SCALE. */
static const real OFFSET[INPUTS] = { {{ listed(e.offset) }} };
static const real PER_SCALE[INPUTS] = { {{ listed(1.0 / e.scale) }} };
{% if straight %}
/* Inputs that enter linearly, deg/h per unit. */
static const real STRAIGHT[INPUTS] = { {{ listed(e.straight_deg_h) }} };
{% endif %}
{% if physics %}
/* Known physics: its coefficients in deg/h per unit, what is taken off each term, and where it is clipped. */
static const real PHYSICS[TERMS] = { {{ listed(e.physics_deg_h) }} };
static const real PHYSICS_MEAN[TERMS] = { {{ listed(e.physics_mean) }} };
static const real PHYSICS_LEAST[TERMS] = { {{ listed(e.physics_limits[0]) }} };
static const real PHYSICS_MOST[TERMS] = { {{ listed(e.physics_limits[1]) }} };
{% for table, values in term_tables %}
static const real {{ table }}[{{ values|length }}] = { {{ listed(values) }} };
{% endfor %}
{% endif %}
{% if form == "polynomial" %}

static const real POWERS[{{ e.powers|length }}][INPUTS] = {
{% for coefficients in e.powers %}
    { {{ listed(coefficients) }} },
{% endfor %}
};
{% endif %}
{% if form == "wide" %}

static const real LINEAR[INPUTS] = { {{ listed(e.linear) }} };
/* Upper triangle of Q, row by row; the diagonal is halved, so that x'Qx / 2 = sum x_j (sum_{k >= j} Q_jk x_k). */
static const real QUADRATIC[{{ triangle|length }}] = {
    {{ listed(triangle) }}
};
{% endif %}
{% if blocks %}

/* Centres in blocks of LANES, so that a block is worked on side by side; the last block is filled with weights of zero. */
static const real CENTRES[BLOCKS][INPUTS][LANES] = {
{% for block in centre_blocks %}
    {
{% for lane in block %}
        { {{ listed(lane) }} },
{% endfor %}
    },
{% endfor %}
};
static const real WEIGHTS[BLOCKS][LANES] = {
{% for lane in weight_blocks %}
    { {{ listed(lane) }} },
{% endfor %}
};
{% endif %}

/* Infinity and NaN less themselves are NaN. */
#define IS_FINITE(value) ((value) - (value) == 0)
{% if exponentials %}

/* exp(t) for -1e5 <= t <= 16, to which clipped inputs confine it: 2^k times the series of exp on |r| <= ln(2) / 2, and 0 where
 * 2^k would be below the smallest normal number. Relative error below {{ exp.error }}. Nothing in it depends on a comparison of real
 * numbers, so that compilers work on several centres side by side. */
static inline real exponential(real t)
{
    {{ exp.bits }} bits;
    real r, scale;
    int32_t k = (int32_t)(t * {{ 1.4426950408889634|number }} + {{ 1024.5|number }}) - 1024;

    k = k < -{{ exp.bias }} ? -{{ exp.bias }} : k;
    r = (t - (real)k * {{ exp.ln2_high|number }}) - (real)k * {{ exp.ln2_low|number }};
    bits = ({{ exp.bits }})(k + {{ exp.bias }}) << {{ exp.shift }};
    memcpy(&scale, &bits, sizeof scale);
    return scale * ({{ horner(exp.series, "r") }});
}
{% endif %}
{% if form == "matern" and not libm %}

/* Square root by four steps of Newton's rule from a guess that halves the exponent; 0 for 0. */
static inline real square_root(real t)
{
    {{ exp.bits }} bits;
    real root;

    if (t < {{ exp.tiny|number }}) {
        return 0;
    }
    memcpy(&bits, &t, sizeof bits);
    bits = (bits >> 1) + {{ exp.root }};
    memcpy(&root, &bits, sizeof root);
{% for _ in range(4) %}
    root = {{ 0.5|number }} * (root + t / root);
{% endfor %}
    return root;
}
{% endif %}
{% if form == "wide" %}

{% if blocks %}
{% if largest_argument > 1 %}
/* exp(u) - 1 - u - u^2 / 2: by its series below 1, where the difference would cancel. |u| <= {{ "%.3g"|format(largest_argument) }} here. */
static inline real third_remainder(real u)
{
    const real one = 1;
    const real near = u * u * u * ({{ horner(series, "u") }});
    const real far = exponential(u) - one - u - {{ 0.5|number }} * u * u;
    {{ exp.bits }} bits, limit, near_bits, far_bits, choice;
    real chosen;

    memcpy(&bits, &u, sizeof bits);
    memcpy(&limit, &one, sizeof limit);
    memcpy(&near_bits, &near, sizeof near_bits);
    memcpy(&far_bits, &far, sizeof far_bits);
    choice = ({{ exp.bits }})0 - ({{ exp.bits }})(bits << 1 < limit << 1); /* all ones for |u| < 1: a choice without a branch */
    choice = (near_bits & choice) | (far_bits & ~choice);
    memcpy(&chosen, &choice, sizeof chosen);
    return chosen;
}
{% else %}
/* exp(u) - 1 - u - u^2 / 2, by its series: |u| <= {{ "%.3g"|format(largest_argument) }} here. */
static inline real third_remainder(real u)
{
    return u * u * u * ({{ horner(series, "u") }});
}
{% endif %}

{% endif %}
/* exp(t) - 1 for t <= 0. */
static real fall_of(real t)
{
    return t > {{ (-0.35)|number }} ? t * ({{ horner(exp.series[1:], "t") }}) : exponential(t) - 1;
}
{% endif %}
{% if form == "matern" %}

/* (1 + sqrt(3) d) exp(-sqrt(3) d) of the squared distance. */
static inline real kernel(real squared)
{
    const real far = {{ root_function }}({{ 3.0|number }} * squared);
    return ({{ 1.0|number }} + far) * exponential(-far);
}
{% elif form == "gaussian" %}

/* exp(-d^2 / 2) of the squared distance. */
static inline real kernel(real squared)
{
    return exponential({{ (-0.5)|number }} * squared);
}
{% elif form == "power" %}

/* (product + offset)^{{ e.kernel_degree }}. */
static inline real kernel(real product)
{
    const real base = product + {{ e.kernel_offset|number }};
    return base{{ " * base" * (e.kernel_degree - 1) }};
}
{% elif form == "sigmoid" %}

/* tanh(product + offset). */
static inline real kernel(real product)
{
    const real t = product + {{ e.kernel_offset|number }};
    const real shrunk = exponential(t < 0 ? t + t : -t - t);
    const real size = ({{ 1.0|number }} - shrunk) / ({{ 1.0|number }} + shrunk);
    return t < 0 ? -size : size;
}
{% endif %}
{% if blocks %}

/* Sum over centres. */
static real sum_over_centres(const real x[INPUTS])
{
    real total[LANES] = { 0 };
    real sum = 0;
    int block, lane;

    for (block = 0; block < BLOCKS; ++block) {
        const real (*z)[LANES] = CENTRES[block];

        for (lane = 0; lane < LANES; ++lane) {
{% if form in ("gaussian", "matern") %}
{% for j in range(e.features) %}
            const real apart{{ j }} = x[{{ j }}] - z[{{ j }}][lane];
{% endfor %}
            const real u = {% for j in range(e.features) %}{{ " + " if j }}apart{{ j }} * apart{{ j }}{% endfor %};
{% else %}
            const real u = {% for j in range(e.features) %}{{ " + " if j }}x[{{ j }}] * z[{{ j }}][lane]{% endfor %};
{% endif %}

            total[lane] += WEIGHTS[block][lane] * {{ "third_remainder" if form == "wide" else "kernel" }}(u);
        }
    }
    for (lane = 0; lane < LANES; ++lane) {
        sum += total[lane];
    }
    return sum;
}
{% endif %}

/* Bias in deg/h of the model's inputs. *outside becomes by how many spans of its training range inputs lie beyond it, summed, and
 * *flagged 1 where one does. */
static real bias_of(const real inputs[INPUTS{{ " + TERMS" if physics }}], real *outside, int *flagged)
{
    real x[INPUTS];
    real v;
{% if physics or straight %}
    real known = 0;
{% endif %}
    int j;
{% if form == "wide" %}
    real square = 0, sums = 0, fall;
    int k, place = 0;
{% endif %}

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
{% if straight %}
        known += STRAIGHT[j] * (clipped - OFFSET[j]);
{% endif %}
    }
{% if form == "polynomial" %}
    v = {{ e.constant|number }};
    for (j = 0; j < INPUTS; ++j) {
        v += x[j] * ({{ nested_powers }});
    }
{% elif form == "wide" %}
    for (j = 0; j < INPUTS; ++j) {
        real row = LINEAR[j];

        for (k = j; k < INPUTS; ++k) {
            row += QUADRATIC[place++] * x[k];
        }
        sums += x[j] * row;
        square += x[j] * x[j];
    }
{% if blocks %}
    sums += sum_over_centres(x);
{% endif %}
    fall = fall_of({{ (-0.5)|number }} * square);
    v = {{ e.constant|number }} + {{ e.level|number }} * fall + ({{ 1.0|number }} + fall) * sums;
{% else %}
    v = {{ e.constant|number }}{% if blocks %} + sum_over_centres(x){% endif %};
{% endif %}
{% if physics %}
    for (j = 0; j < TERMS; ++j) {
        real term = inputs[INPUTS + j];

        term = term < PHYSICS_LEAST[j] ? PHYSICS_LEAST[j] : term;
        term = term > PHYSICS_MOST[j] ? PHYSICS_MOST[j] : term;
        known += PHYSICS[j] * (term - PHYSICS_MEAN[j]);
    }
{% endif %}
{% if physics or straight %}
    return {{ e.y_mean_deg_h|number }} + {{ e.y_scale_deg_h|number }} * v + known;
{% else %}
    return {{ e.y_mean_deg_h|number }} + {{ e.y_scale_deg_h|number }} * v;
{% endif %}
}
{% if "behind" in helpers %}

/* First-order low-pass filter by the backward Euler rule: how far its output is behind the monitor after this step. */
static real behind(real *state, real monitor, real step_s, real time_constant_s)
{
    const real share = step_s > 0 ? step_s / (time_constant_s + step_s) : 0;
{% if compensated %}
    /* state[1] carries what rounding takes from state[0]: without it a slow filter would stop short of its input. */
    const real move = share * ((monitor - state[0]) - state[1]) + state[1];
    const real moved = state[0] + move;

    state[1] = move - (moved - state[0]);
    state[0] = moved;
    return (state[0] - monitor) + state[1];
{% else %}
    state[0] = state[0] + share * (monitor - state[0]);
    return state[0] - monitor;
{% endif %}
}
{% endif %}
{% if "low_passed" in helpers %}

/* The same filter's output. */
static real low_passed(real *state, real value, real step_s, real time_constant_s)
{
    const real share = step_s > 0 ? step_s / (time_constant_s + step_s) : 0;

    *state = *state + share * (value - *state);
    return *state;
}
{% endif %}
{% if "left_behind" in helpers %}

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
{% endif %}
{% if "lags" in helpers %}

/* Weighted sum of how far filters of several time constants are behind. */
static real lags(real *states, real value, real step_s, const real *times, const real *weights, int count)
{
    real total = 0;
    int j;

    for (j = 0; j < count; ++j) {
        total += weights[j] * behind(&states[j], value, step_s, times[j]);
    }
    return total;
}
{% endif %}
{% if "plays" in helpers %}

/* Weighted sum of play operators of several radii, relative to their input. */
static real plays(real *states, real value, const real *radii, const real *weights, int count)
{
    real total = 0;
    int j;

    for (j = 0; j < count; ++j) {
        total += weights[j] * left_behind(&states[j], value, radii[j]);
    }
    return total;
}
{% endif %}
{% if "relays" in helpers %}

/* Relays at the first value: on from their levels upwards. */
static void begin_relays(unsigned char *on, real value, const real *levels, int count)
{
    int j;

    for (j = 0; j < count; ++j) {
        on[j] = value >= levels[j];
    }
}

/* Weighted sum of relays, each on from one threshold upwards until another downwards. */
static real relays(unsigned char *on, real value, const real *up, const real *down, const real *weights, int count)
{
    real total = 0;
    int j;

    for (j = 0; j < count; ++j) {
        if (value >= up[j]) {
            on[j] = 1;
        } else if (value <= down[j]) {
            on[j] = 0;
        }
        total += on[j] ? weights[j] : 0;
    }
    return total;
}
{% endif %}
{% if "table" in helpers %}

/* A function by cubics between knots, straight lines beyond. */
static real table(real value, const real *knots, const real *values, const real *cubics, int count, real below, real above)
{
    const real *c;
    real t;
    int low = 0, high = count - 1;

    if (value < knots[0]) {
        return values[0] + below * (value - knots[0]);
    }
    if (value >= knots[high]) {
        return values[high] + above * (value - knots[high]);
    }
    while (high - low > 1) {
        const int middle = (low + high) / 2;

        if (value >= knots[middle]) {
            low = middle;
        } else {
            high = middle;
        }
    }
    c = cubics + 4 * low;
    t = value - knots[low];
    return ((c[0] * t + c[1]) * t + c[2]) * t + c[3];
}
{% endif %}
{% if "decay" in helpers %}

/* exp(-t) for t >= 0. */
static real decay(real t)
{
    return t > {{ 700.0|number }} ? 0 : exponential(-t);
}
{% endif %}
{% if "bouc_wen" in helpers %}

/* Bouc and Wen's z, exact while it keeps its sign; states: a play operator against noise, z, and the play's last output. */
static real bouc_wen(real *states, real value, real width, real saturation)
{
    const real before = states[2];
    const real scale = saturation / {{ 0.6|number }};
    real u, way, at;

    left_behind(&states[0], value, width);
    u = states[0];
    way = u > before ? u - before : before - u;
    at = u > before ? states[1] : -states[1];
    at = at > 0 ? saturation + (at - saturation) * decay(way / saturation) : scale + (at - scale) * decay(way / scale);
    states[1] = u > before ? at : -at;
    states[2] = u;
    return states[1];
}
{% endif %}
{% if "coleman" in helpers %}

static real bent(real t)
{
    const real shrunk = decay(t < 0 ? -t - t : t + t);
    const real size = (1 - shrunk) / (1 + shrunk);

    return t < 0 ? -size : size;
}

/* Coleman and Hodgdon's z at the first value: the mean of its curve over the way by which it came. */
static real first_coleman(real value, real centre, real width, const real *offsets, const real *shares, int count)
{
    real total = 0;
    int j;

    for (j = 0; j < count; ++j) {
        total += shares[j] * bent((value - offsets[j] - centre) / width);
    }
    return total;
}

/* Coleman and Hodgdon's z; states as of Bouc and Wen's. */
static real coleman(real *states, real value, real width, real radius, real centre, real curve)
{
    const real before = states[2];
    real u, keep;

    left_behind(&states[0], value, width);
    u = states[0];
    keep = decay((u > before ? u - before : before - u) / radius);
    states[1] = keep * states[1] + (1 - keep) * bent(({{ 0.5|number }} * (u + before) - centre) / curve);
    states[2] = u;
    return states[1];
}
{% endif %}

void {{ p }}_init({{ p }}_state *state)
{
{% if relays %}
    int relay;
{% endif %}
{% if slots %}
    int slot;
{% endif %}

{% if slots %}
    for (slot = 0; slot < {{ slots }}; ++slot) {
        state->memory[slot] = 0;
    }
{% endif %}
{% if relays %}
    for (relay = 0; relay < {{ relays }}; ++relay) {
        state->relays[relay] = 0;
    }
{% endif %}
    state->time_s = 0;
{% if offset_s %}
    state->offset_begin_s = 0;
    state->offset_total_deg_h = 0;
    state->offset_count = 0;
    state->offset_over = 0;
{% endif %}
    state->refused_s = 0;
    state->refused = 0;
    state->bias_deg_h = {{ e.y_mean_deg_h|number }};
    state->half_width_deg_h = {{ interval.per_span_deg_h|number }};
    state->started = 0;
}

static int answer(const {{ p }}_state *state, int status, {{ p }}_result *result)
{
    result->bias_deg_h = state->bias_deg_h;
    result->half_width_deg_h = state->half_width_deg_h;
    result->correction_deg_h = state->bias_deg_h - {{ e.reference_deg_h|number }};
    result->status = status;
    return status;
}

{{ correct }}
{
    return {{ rate_deg_h }} - (double)result->correction_deg_h;
}

int {{ p }}_step({{ p }}_state *state, double time_s, const {{ p }}_real monitors[{{ P }}_MONITORS], {{ p }}_result *result)
{
    {{ p }}_state next = *state; /* kept once the sample is known to be valid */
    real inputs[INPUTS{{ " + TERMS" if physics }}];
{% if steps %}
    real step_s;
{% endif %}
    real outside = 0;
    int k, {{ "first = !state->started, " if firsts }}flagged = 0, valid = IS_FINITE(time_s);

    for (k = 0; k < {{ P }}_MONITORS; ++k) {
        valid = valid && IS_FINITE(monitors[k]);
    }
    if (!valid) {
        return answer(state, {{ P }}_INVALID, result);
    }
    if (state->started && (time_s <= state->time_s || time_s - state->time_s > LONGEST_STEP_S)) {
        /* a wild time stamp, or a gap or a clock set back: the samples that follow tell */
        int follows = state->refused > 0 && time_s > state->refused_s && time_s - state->refused_s <= LONGEST_STEP_S;
        double before_s = state->refused_s;

        state->refused = follows ? state->refused + 1 : 1;
        state->refused_s = time_s;
        if (state->refused < (time_s > state->time_s ? 2 : 4)) {
            return answer(state, {{ P }}_INVALID, result);
        }
        if (time_s <= state->time_s) {
            next.time_s = before_s;
        }
    }
    next.refused = 0;
    if (!next.started) {
        next.started = 1;
        next.time_s = time_s;
{% for slot, monitor in starts %}
        next.memory[{{ slot }}] = monitors[{{ P }}_{{ monitor }}];
{% endfor %}
{% for line in begins %}
        {{ line }}
{% endfor %}
    }
{% if steps %}
    step_s = (real)(time_s - next.time_s);
{% endif %}
    next.time_s = time_s;

{% for line in feature_lines %}
    {{ line }}
{% endfor %}

    for (k = 0; k < INPUTS{{ " + TERMS" if physics }}; ++k) {
        if (!IS_FINITE(inputs[k])) {
            return answer(state, {{ P }}_INVALID, result);
        }
    }
    next.bias_deg_h = bias_of(inputs, &outside, &flagged);
    next.half_width_deg_h = {{ interval.inside_deg_h|number }} + {{ interval.per_span_deg_h|number }} * outside;
    *state = next;
    return answer(state, flagged ? {{ P }}_OUT_OF_RANGE : {{ P }}_OK, result);
}
{% if offset_s %}

int {{ p }}_step_zeroed({{ p }}_state *state, double time_s, const {{ p }}_real monitors[{{ P }}_MONITORS], {{ gyro_arguments }},
    {{ p }}_result *result)
{
    const double rate_deg_h = {{ rate_deg_h }};
    const double last_s = state->time_s;
    const int first = !state->started;
    const int status = IS_FINITE(rate_deg_h) ? {{ p }}_step(state, time_s, monitors, result) : answer(state, {{ P }}_INVALID, result);
    double offset_deg_h;

    if (status != {{ P }}_INVALID) {
        if (first) {
            state->offset_begin_s = time_s;
        } else if (time_s <= last_s) {
            state->offset_begin_s += time_s - last_s; /* the clock was set back */
        }
        state->offset_over = state->offset_over || time_s - state->offset_begin_s >= {{ offset_s|double }};
        if (!state->offset_over) {
            state->offset_total_deg_h += rate_deg_h - (double)result->bias_deg_h;
            ++state->offset_count;
        }
    }
    offset_deg_h = state->offset_count > 0 ? state->offset_total_deg_h / state->offset_count : 0.0;
    result->bias_deg_h = (real)((double)result->bias_deg_h + offset_deg_h);
    result->correction_deg_h = (real)((double)result->correction_deg_h + offset_deg_h);
    if (state->offset_over) {
        result->half_width_deg_h += {{ narrower_deg_h|number }};
    }
    return status;
}
{% endif %}
