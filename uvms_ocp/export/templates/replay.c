/* Replays a recorded run: feeds the controller with what was measured, and compares what it tells with what Python told.

   ./NAME_replay NAME_recorded.bin [ticks.txt or - [tolerance]]

   NAME_recorded.bin holds numbers of 8 bytes, least byte first: for each tick the fields of NAME_ControllerInputs, then those
   of NAME_ControllerOutputs, one after the other. With ticks.txt what the controller tells is written there, one tick per line.
   Exit code 0 if all numbers are the same to the last bit, or agree to the tolerance where one is given, and all else is equal;
   1 if not, 2 where a file cannot be read. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "NAME_controller.h"

#define COUNT(array) (sizeof(array) / sizeof((array)[0]))

static int read_numbers(FILE *file, double *x, size_t n) {
  unsigned char bytes[8];
  for (size_t i = 0; i < n; i++) {
    unsigned long long bits = 0;
    if (fread(bytes, 1, 8, file) != 8) return 0;
    for (int k = 7; k >= 0; k--) bits = bits << 8 | bytes[k];
    memcpy(&x[i], &bits, 8);
  }
  return 1;
}

static int read_integers(FILE *file, int *k, size_t n) {
  double x;
  for (size_t i = 0; i < n; i++) {
    if (!read_numbers(file, &x, 1)) return 0;
    k[i] = (int)x;
  }
  return 1;
}

static int read_tick(FILE *file, NAME_ControllerInputs *in, NAME_ControllerOutputs *out) {
  return read_numbers(file, &in->t, 1) && read_numbers(file, in->q, COUNT(in->q)) &&
         read_numbers(file, in->v, COUNT(in->v)) && read_numbers(file, &in->altimeter_range, 1) &&
         read_numbers(file, &in->age, 1) && read_numbers(file, &in->joint_age, 1) &&
         read_integers(file, in->trust, COUNT(in->trust)) && read_numbers(file, in->since, COUNT(in->since)) &&
         read_numbers(file, out->v, COUNT(out->v)) && read_numbers(file, out->thrust, COUNT(out->thrust)) &&
         read_numbers(file, out->torque, COUNT(out->torque)) && read_integers(file, &out->hold, 1) &&
         read_integers(file, &out->stop, 1) && read_integers(file, &out->brakes, 1) &&
         read_integers(file, &out->finished, 1) && read_integers(file, &out->phase, 1) &&
         read_integers(file, &out->freshness, 1) && read_integers(file, &out->status, 1) &&
         read_numbers(file, &out->viable_share, 1) &&
         read_numbers(file, out->quantities, COUNT(out->quantities));
}

typedef struct {
  double largest; /* difference of two numbers */
  int bits;       /* some number has other bits */
} Difference;

static void compare(Difference *found, const double *x, const double *y, size_t n) {
  for (size_t i = 0; i < n; i++) {
    double apart = fabs(x[i] - y[i]);
    if (memcmp(&x[i], &y[i], sizeof(double)) == 0 || (isnan(x[i]) && isnan(y[i]))) continue;
    found->bits = 1;
    if (x[i] == y[i]) continue;
    if (!(apart <= found->largest)) found->largest = isnan(apart) ? INFINITY : apart;
  }
}

static Difference difference(const NAME_ControllerOutputs *a, const NAME_ControllerOutputs *b) {
  Difference found = {0, 0};
  compare(&found, a->v, b->v, COUNT(a->v));
  compare(&found, a->thrust, b->thrust, COUNT(a->thrust));
  compare(&found, a->torque, b->torque, COUNT(a->torque));
  compare(&found, &a->viable_share, &b->viable_share, 1);
  compare(&found, a->quantities, b->quantities, COUNT(a->quantities));
  return found;
}

static int same(const NAME_ControllerOutputs *a, const NAME_ControllerOutputs *b) {
  return a->hold == b->hold && a->stop == b->stop && a->brakes == b->brakes && a->finished == b->finished &&
         a->phase == b->phase && a->freshness == b->freshness && a->status == b->status;
}

static void write_tick(FILE *file, const NAME_ControllerOutputs *out) {
  for (size_t i = 0; i < COUNT(out->v); i++) fprintf(file, "%.17g ", out->v[i]);
  for (size_t i = 0; i < COUNT(out->thrust); i++) fprintf(file, "%.17g ", out->thrust[i]);
  for (size_t i = 0; i < COUNT(out->torque); i++) fprintf(file, "%.17g ", out->torque[i]);
  fprintf(file, "%d %d %d %d %d %d %d\n", out->hold, out->stop, out->brakes, out->finished, out->phase, out->freshness,
          out->status);
}

int main(int argc, char **argv) {
  static NAME_Controller controller;
  static NAME_ControllerInputs in;
  static NAME_ControllerOutputs recorded, told;
  FILE *file = argc > 1 ? fopen(argv[1], "rb") : 0;
  FILE *ticks = argc > 2 && strcmp(argv[2], "-") != 0 ? fopen(argv[2], "w") : 0;
  double tolerance = argc > 3 ? atof(argv[3]) : 0;
  long n = 0, apart = 0, first = -1;
  double worst = 0;
  if (!file || (argc > 2 && strcmp(argv[2], "-") != 0 && !ticks)) {
    fprintf(stderr, "usage: %s NAME_recorded.bin [ticks.txt or - [tolerance]]; a file cannot be opened\n", argv[0]);
    return 2;
  }
  NAME_controller_reset(&controller);
  for (; read_tick(file, &in, &recorded); n++) {
    Difference by;
    NAME_controller_step(&controller, &in, &told);
    by = difference(&told, &recorded);
    if (by.largest > worst) worst = by.largest;
    if ((tolerance > 0 ? by.largest > tolerance : by.bits) || !same(&told, &recorded)) {
      apart++;
      if (first < 0) first = n;
    }
    if (ticks) write_tick(ticks, &told);
  }
  fclose(file);
  if (ticks) fclose(ticks);
  printf("%ld ticks, %ld apart, largest difference %.3g", n, apart, worst);
  if (apart) printf(", first at tick %ld", first);
  printf("\n");
  return n == 0 ? 2 : apart != 0;
}
