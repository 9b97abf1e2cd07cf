#ifndef ${NAME}_H
#define ${NAME}_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

$include $text.h

extern const ${name}_model ${name}_default;
extern const ${name}_state ${name}_start;

#ifdef __cplusplus
}
#endif

#endif
