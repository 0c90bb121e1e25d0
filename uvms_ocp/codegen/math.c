#include <math.h>
static inline double larger(double x, double y) { return x >= y || y != y ? x : y; }
static inline double smaller(double x, double y) { return x <= y || y != y ? x : y; }
#define fmax larger
#define fmin smaller
