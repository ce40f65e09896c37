/* $title: see $name.h.
 *
 *     x+ = AFTER + A (x - STATE) + B (u - ACTING),  y = SHOWN + C (x - STATE)
 */
#include "$name.h"

#include <math.h>

#define STATES ${NAME}_STATES

typedef ${name}_real real;

/* Of each contact mode; filled up with zeros. */
$tables
void ${name}_init($name *body)
{
    int i;
    body->contact = 0;
    for (i = 0; i < STATES; ++i)
        body->x[i] = STATE[0][i];
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
    for (i = 0; i < STATES; ++i) {
        body->x[i] = 0;
        for (j = 0; j < STATES; ++j)
            body->x[i] += SWITCH_MAP[map][i][j] * before.x[j];
    }
    body->contact = contact;
    return 0;
}

int ${name}_step($name *body, const real u[])
{
    const int mode = body->contact;
    real after[STATES];
    int i, j;
    for (i = 0; i < STATES; ++i)
        after[i] = AFTER[mode][i];
    for (j = 0; j < STATES; ++j) {
        const real away = body->x[j] - STATE[mode][j];
        for (i = 0; i < STATES; ++i)
            after[i] += A[mode][j][i] * away;
    }
    for (j = 0; j < ${NAME}_INPUTS; ++j) {
        const real away = u[j] - ACTING[mode][j];
        for (i = 0; i < STATES; ++i)
            after[i] += B[mode][j][i] * away;
    }
    for (i = 0; i < STATES; ++i)
        if (!isfinite(after[i]))
            return -1;
    for (i = 0; i < STATES; ++i)
        body->x[i] = after[i];
    return 0;
}

void ${name}_outputs(const $name *body, real y[])
{
    int i, k;
    for (k = 0; k < ${NAME}_OUTPUTS; ++k) {
        y[k] = SHOWN[body->contact][k];
        for (i = 0; i < STATES; ++i)
            y[k] += C[body->contact][k][i] * (body->x[i] - STATE[body->contact][i]);
    }
}
