#include <math.h>
#include <stdlib.h>
#include <string.h>
static inline double lesser_of(double x, double y) { return y < x ? y : x; }
static inline double greater_of(double x, double y) { return y > x ? y : x; }
static inline int lesser_of_int(int x, int y) { return y < x ? y : x; }
static inline int greater_of_int(int x, int y) { return y > x ? y : x; }
