/* $title: see $name.h.
 *
 *     d = A^-1 (G u - w e - (D + h/2 w^2) r),  A = 2/h + D + h/2 w^2,  v = r + d,  e += h w v,  r += 2 d
 *     E+ - E = h (G u) v - h v D v, exactly
 *
 * d, the change of the velocity to the middle of the step, is small, and so is what float rounds of it.
 */
#include "$name.h"

#include <math.h>

#define ORDER ${NAME}_ORDER
#define SHARED $shared /* inputs of all contact modes, the last */
#define DENSE_DAMPING $dense

typedef ${name}_real real;

static const real DT = (real)${NAME}_DT; /* s */

/* Of each contact mode its first input, and how many it has; then arrays of all of them, filled up with zeros. */
$tables
void ${name}_init($name *body)
{
    static const $name at_rest;
    *body = at_rest;
}

double ${name}_energy(const $name *body)
{
    double twice = 0;
    int i;
    for (i = 0; i < ORDER; ++i) {
        twice += (double)body->r[i] * body->r[i];
        if (i >= ${NAME}_RIGID)
            twice += (double)body->e[i] * body->e[i];
    }
    return twice / 2;
}

int ${name}_switch($name *body, int contact)
{
    const $name before = *body;
    const int map = before.contact * (${NAME}_CONTACTS - 1) + contact - (contact > before.contact);
    int i, j;
    if (contact < 0 || contact >= ${NAME}_CONTACTS)
        return -1;
    if (contact == before.contact)
        return 0;
    for (i = 0; i < ORDER; ++i) {
        body->e[i] = body->r[i] = 0;
        for (j = 0; j < ORDER; ++j) {
            body->e[i] += POTENTIAL_MAP[map][i][j] * before.e[j];
            body->r[i] += KINETIC_MAP[map][i][j] * before.r[j];
        }
    }
    body->contact = contact;
    body->lost_in_switching += ${name}_energy(&before) - ${name}_energy(body);
    return 0;
}

int ${name}_step($name *body, const real u[])
{
    const int mode = body->contact, first = FIRST_INPUT[mode], shared = ${NAME}_INPUTS - SHARED;
    real force[ORDER] = {0}, change[ORDER], supplied = 0, dissipated = 0;
    int i, j;

    for (j = 0; j < INPUT_COUNT[mode]; ++j)
        for (i = 0; i < ORDER; ++i)
            force[i] += INPUT[first + j][i] * u[first + j];
    for (j = 0; j < SHARED; ++j)
        for (i = 0; i < ORDER; ++i)
            force[i] += SHARED_INPUT[mode][j][i] * u[shared + j];
#if DENSE_DAMPING
    {
        const real inertia = 2 / DT;
        real right[ORDER], heat[ORDER] = {0};
        for (i = 0; i < ORDER; ++i) {
            right[i] = force[i] - FREQUENCY[mode][i] * body->e[i];
            change[i] = 0;
        }
        for (j = 0; j < ORDER; ++j)
            for (i = 0; i < ORDER; ++i)
                heat[i] += HEAT[mode][j][i] * (right[j] + inertia * body->r[j]);
        for (j = 0; j < ORDER; ++j)
            for (i = 0; i < ORDER; ++i)
                right[i] -= RESISTANCE[mode][j][i] * body->r[j];
        for (j = 0; j < ORDER; ++j)
            for (i = 0; i < ORDER; ++i)
                change[i] += COMPLIANCE[mode][j][i] * right[j];
        for (i = 0; i < ORDER; ++i)
            dissipated += heat[i] * heat[i];
    }
#else
    for (i = 0; i < ORDER; ++i)
        change[i] = COMPLIANCE[mode][i]
            * (force[i] - FREQUENCY[mode][i] * body->e[i] - RESISTANCE[mode][i] * body->r[i]);
#endif
    for (i = 0; i < ORDER; ++i) {
        const real v = body->r[i] + change[i];
        supplied += force[i] * v;
#if !DENSE_DAMPING
        dissipated += DAMPING[mode][i] * v * v;
#endif
    }
    if (!isfinite(supplied) || !isfinite(dissipated))
        return -1;
    for (i = 0; i < ORDER; ++i) {
        body->e[i] += TRAVEL[mode][i] * (body->r[i] + change[i]);
        body->r[i] += 2 * change[i];
    }
    body->supplied += DT * supplied;
    body->dissipated += DT * dissipated;
    return 0;
}

void ${name}_outputs(const $name *body, real y[])
{
    int i, k;
    for (k = 0; k < ${NAME}_OUTPUTS; ++k) {
        y[k] = 0;
        for (i = 0; i < ORDER; ++i)
            y[k] += OUTPUT[body->contact][k][i] * body->e[i];
    }
}
