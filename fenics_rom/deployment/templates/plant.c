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

/* What inputs push with in a contact mode. */
static inline void push(int mode, const real u[], real force[])
{
    const int first = FIRST_INPUT[mode], shared = ${NAME}_INPUTS - SHARED;
    int i, j;
    for (i = 0; i < ORDER; ++i)
        force[i] = 0;
    for (j = 0; j < INPUT_COUNT[mode]; ++j)
        for (i = 0; i < ORDER; ++i)
            force[i] += INPUT[first + j][i] * u[first + j];
    for (j = 0; j < SHARED; ++j)
        for (i = 0; i < ORDER; ++i)
            force[i] += SHARED_INPUT[mode][j][i] * u[shared + j];
}

/* Ends a step of such a share of DT, with d and, where damping is dense, the power that is dissipated. */
static inline int advance($name *body, real share, const real force[], const real change[], real dissipated)
{
    const int mode = body->contact;
    real supplied = 0;
    int i;
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
        body->e[i] += share * TRAVEL[mode][i] * (body->r[i] + change[i]);
        body->r[i] += 2 * change[i];
    }
    body->supplied += share * DT * supplied;
    body->dissipated += share * DT * dissipated;
    return 0;
}

int ${name}_step($name *body, const real u[])
{
    const int mode = body->contact;
    real force[ORDER], change[ORDER], dissipated = 0;
    int i;

    push(mode, u, force);
#if DENSE_DAMPING
    {
        const real inertia = 2 / DT;
        real right[ORDER], heat[ORDER] = {0};
        int j;
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
    return advance(body, 1, force, change, dissipated);
}

int ${name}_step_by($name *body, const real u[], double h)
{
    const int mode = body->contact;
    const real inertia = (real)(2 / h), half = (real)(h / 2);
    real force[ORDER], change[ORDER], dissipated = 0;
    int i;

    if (!(h > 0) || !isfinite(h) || !isfinite(inertia))
        return -1;
    push(mode, u, force);
#if DENSE_DAMPING
    {
        real A[ORDER][ORDER], v[ORDER]; /* D + h/2 w^2, then the Cholesky factor of A below its diagonal, and on it */
        int j, k;
        for (i = 0; i < ORDER; ++i) {
            for (j = 0; j < ORDER; ++j)
                A[i][j] = RESISTANCE[mode][i][j];
            A[i][i] += (half - DT / 2) * FREQUENCY[mode][i] * FREQUENCY[mode][i];
            change[i] = force[i] - FREQUENCY[mode][i] * body->e[i];
        }
        for (i = 0; i < ORDER; ++i)
            for (j = 0; j < ORDER; ++j)
                change[i] -= A[i][j] * body->r[j];
        for (j = 0; j < ORDER; ++j) {
            A[j][j] += inertia;
            for (k = 0; k < j; ++k)
                A[j][j] -= A[j][k] * A[j][k];
            if (!(A[j][j] > 0))
                return -1;
            A[j][j] = (real)sqrt(A[j][j]);
            for (i = j + 1; i < ORDER; ++i) {
                for (k = 0; k < j; ++k)
                    A[i][j] -= A[i][k] * A[j][k];
                A[i][j] /= A[j][j];
            }
        }
        for (i = 0; i < ORDER; ++i) {
            for (k = 0; k < i; ++k)
                change[i] -= A[i][k] * change[k];
            change[i] /= A[i][i];
        }
        for (i = ORDER - 1; i >= 0; --i) {
            for (k = i + 1; k < ORDER; ++k)
                change[i] -= A[k][i] * change[k];
            change[i] /= A[i][i];
        }
        for (i = 0; i < ORDER; ++i)
            v[i] = body->r[i] + change[i];
        for (i = 0; i < ORDER; ++i) {
            real resisted = -DT / 2 * FREQUENCY[mode][i] * FREQUENCY[mode][i] * v[i]; /* D v */
            for (j = 0; j < ORDER; ++j)
                resisted += RESISTANCE[mode][i][j] * v[j];
            dissipated += v[i] * resisted;
        }
    }
#else
    for (i = 0; i < ORDER; ++i) {
        const real resistance = DAMPING[mode][i] + half * FREQUENCY[mode][i] * FREQUENCY[mode][i];
        change[i] = (force[i] - FREQUENCY[mode][i] * body->e[i] - resistance * body->r[i]) / (inertia + resistance);
    }
#endif
    return advance(body, (real)(h / ${NAME}_DT), force, change, dissipated);
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
