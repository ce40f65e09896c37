/* $title
 *
 * A reduced soft body as a state space, in steps of $dt s: made by fenics_rom $version. Needs no library, allocates
 * nothing, and a step takes $work multiplications, whatever its input is. $about
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
#define ${NAME}_STATES $states /* numbers in the state, the most of all contact modes */
#define ${NAME}_ANY_STEP 0 /* steps are of this length alone */
#define ${NAME}_ACCOUNT 0 /* and keep no energy account */

enum { /* contact modes */
$contact_modes
    ${NAME}_CONTACTS
};

enum { /* inputs: those of a contact mode act while it is active */
$inputs
    ${NAME}_INPUTS
};

enum { /* outputs */
$outputs
    ${NAME}_OUTPUTS
};

typedef struct {
    int contact; /* the active contact mode */
    ${name}_real x[${NAME}_STATES];
} $name;

/* In the state about which the model is linear, in the first contact mode. */
void ${name}_init($name *body);

/* Makes a contact mode active, and projects the state. 0, or -1 where there is no such contact mode. */
int ${name}_switch($name *body, int contact);

/* Advances by ${NAME}_DT under a constant input. 0, or -1 and all is as it was: the input, or what it leads to, is not
 * finite. */
int ${name}_step($name *body, const ${name}_real u[]);

/* Outputs y[${NAME}_OUTPUTS], in their units. */
void ${name}_outputs(const $name *body, ${name}_real y[]);

#ifdef __cplusplus
}
#endif

#endif
