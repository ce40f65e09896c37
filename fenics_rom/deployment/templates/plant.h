/* $title
 *
 * A reduced soft body by passive midpoint integration, in steps of $dt s: made by fenics_rom $version. Needs no library,
 * allocates nothing, and a step takes $work multiplications, whatever its input is.
 *
 *     $name body;
 *     double u[${NAME}_INPUTS] = {0}, y[${NAME}_OUTPUTS];
 *     ${name}_init(&body);
 *     ${name}_switch(&body, ${NAME}_CONTACT_$last);
 *     ${name}_step(&body, u);
 *     ${name}_outputs(&body, y);
 */
#ifndef ${NAME}_H
#define ${NAME}_H

#ifdef __cplusplus
extern "C" {
#endif

#ifdef ${NAME}_SINGLE
typedef float ${name}_real;
#else
typedef double ${name}_real;
#endif

#define ${NAME}_DT $dt /* s */
#define ${NAME}_ORDER $order /* displacements in the model, the most of all contact modes */
#define ${NAME}_RIGID $rigid /* how many of them, the first, are rigid motions */
#define ${NAME}_ANY_STEP 1 /* there is ${name}_step_by */
#define ${NAME}_ACCOUNT 4 /* sums of the energy account */

enum { /* contact modes */
$contact_modes
    ${NAME}_CONTACTS
};

enum { /* inputs: those of a contact mode act while it is active */
$inputs
    ${NAME}_INPUTS
};

enum { /* outputs: displacements, m */
$outputs
    ${NAME}_OUTPUTS
};

typedef struct {
    int contact; /* the active contact mode */
    ${name}_real e[${NAME}_ORDER]; /* J^0.5; of rigid motions m kg^0.5 */
    ${name}_real r[${NAME}_ORDER]; /* J^0.5; half the squares of both, but for rigid e, is the stored energy */
    double supplied, dissipated, lost_in_switching; /* J: stored = supplied - dissipated - lost in switching */
} $name;

/* At rest in the first contact mode, with an empty account. */
void ${name}_init($name *body);

/* Makes a contact mode active, and projects the state. 0, or -1 where there is no such contact mode. */
int ${name}_switch($name *body, int contact);

/* Advances by ${NAME}_DT under a constant input. 0, or -1 and all is as it was: the input, or what it leads to, is not
 * finite. */
int ${name}_step($name *body, const ${name}_real u[]);

/* The same by any other time h, s; where damping is dense it factorises a matrix, ${NAME}_ORDER^3 / 6 multiplications. */
int ${name}_step_by($name *body, const ${name}_real u[], double h);

/* Displacements y[${NAME}_OUTPUTS], m. */
void ${name}_outputs(const $name *body, ${name}_real y[]);

/* Stored energy, J. */
double ${name}_energy(const $name *body);

#ifdef __cplusplus
}
#endif

#endif
