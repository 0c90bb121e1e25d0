/* Steps a controller 10,000 times from what was recorded, spoilt at random, and checks that it tells nothing but finite numbers.

   random recorded.bin. Every second tick some inputs are NaN, endless, huge or tiny; some ticks jump in time. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "c_controller.h"

#define COUNT(array) (sizeof(array) / sizeof((array)[0]))

static unsigned long long seed = 88172645463325252ull;

static double uniform(void) {
  seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
  return (double)(seed >> 11) / 9007199254740992.0;
}

static int below(int n) { return (int)(uniform() * n); }

static double wild(void) {
  static const double NUMBERS[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 1e300, 1e15, -1e14, 1e-300, 5e-324, -0.0, 0.0, 1.0};
  return NUMBERS[below((int)COUNT(NUMBERS))];
}

static void spoil(double *x, size_t n, int every) {
  for (size_t i = 0; i < n; i++)
    if (below(every) == 0) x[i] = below(2) ? wild() : x[i] + 10 * (uniform() - 0.5);
}

static int all_finite(const double *x, size_t n) {
  for (size_t i = 0; i < n; i++)
    if (!isfinite(x[i])) return 0;
  return 1;
}

static void make(c_ControllerInputs *in, const c_ControllerInputs *sound, int tick) {
  *in = *sound;
  in->t = 0.005 * tick;
  if (tick % 2 == 0) return;
  spoil(in->q, COUNT(in->q), 40);
  spoil(in->v, COUNT(in->v), 40);
  spoil(&in->altimeter_range, 1, 5);
  spoil(&in->age, 1, 20);
  spoil(&in->joint_age, 1, 20);
  spoil(in->since, COUNT(in->since), 20);
  spoil(&in->t, 1, 200);
  for (size_t i = 0; i < COUNT(in->trust); i++)
    if (below(30) == 0) in->trust[i] = below(3);
}

int main(int argc, char **argv) {
  static c_Controller controller;
  static c_ControllerInputs sound, in;
  static c_ControllerOutputs out;
  FILE *file = argc > 1 ? fopen(argv[1], "rb") : 0;
  double numbers[COUNT(sound.q) + 1];
  if (!file || fread(numbers, sizeof(double), COUNT(numbers), file) != COUNT(numbers)) return 2;
  fclose(file);
  memcpy(sound.q, numbers + 1, sizeof(sound.q));
  sound.altimeter_range = 3.0;
  for (int tick = 0; tick < 10000; tick++) {
    if (tick % 500 == 0) c_controller_reset(&controller);
    make(&in, &sound, tick % 500);
    c_controller_step(&controller, &in, &out);
    if (!all_finite(out.v, COUNT(out.v)) || !all_finite(out.thrust, COUNT(out.thrust))) return 1;
    if (!all_finite(out.torque, COUNT(out.torque))) return 1;
  }
  return 0;
}
