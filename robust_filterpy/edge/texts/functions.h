/* A sensor z = h(x) + v, and the motion x(k+1) = f(x(k)) + w(k): functions that write what they are asked for and
   change nothing else. context is handed on to them, for what else they need: a landmark, an input, a time step. */
typedef struct {
    void (*h)(const ${name}_real x[$n], ${name}_real z[$m], const void *context);
    void (*jacobian)(const ${name}_real x[$n], ${name}_real H[$m * $n], const void *context); /* dh/dx, row by row */
    /* z - predicted as they differ (angles are wrapped), or NULL where they subtract. */
    void (*residual)(const ${name}_real z[$m], const ${name}_real predicted[$m], ${name}_real y[$m],
                     const void *context);
    const void *context;
} ${name}_sensor;

typedef struct {
    void (*f)(const ${name}_real x[$n], ${name}_real next[$n], const void *context);
    void (*jacobian)(const ${name}_real x[$n], ${name}_real F[$n * $n], const void *context); /* df/dx */
    const void *context;
} ${name}_motion;
