#include <string.h>
#include <time.h>
typedef void Kernel(void *, void *, void *, void *);
typedef struct { Kernel *kernel; void *memory[4]; int asked; } Step;
typedef struct { const char *from; char *to; long long size, stride; int n, kind; } Column;
enum { SAME, INT_TO_LONG, INT_TO_BYTE, DIFFERENCE };
enum { LOOK = 1, RAISED = 3 };

static double now(void) {
  struct timespec t;
#ifdef CLOCK_MONOTONIC
  clock_gettime(CLOCK_MONOTONIC, &t);
#else
  timespec_get(&t, TIME_UTC);
#endif
  return (double)(t.tv_sec % 1000000) + 1e-9 * (double)t.tv_nsec;
}

static void copy(const Column *c, long long row) {
  char *to = c->to + row * c->stride;
  if (c->kind == SAME) memcpy(to, c->from, (size_t)c->size);
  if (c->kind == DIFFERENCE) *(double *)to = ((const double *)c->from)[c->n] - *(const double *)c->from;
  for (int i = 0; i < c->n && c->kind != SAME && c->kind != DIFFERENCE; ++i) {
    if (c->kind == INT_TO_BYTE) to[i] = (char)((const int *)c->from)[i];
    else ((long long *)to)[i] = ((const int *)c->from)[i];
  }
}

/* Up to n passes, each with a row; ends early after a pass that sets *stop, whose row is left out, and in it where that is above
   LOOK. A function of Python, asked, sets it to 0 as it begins: what its interpreter raises before that is not lost. done: the
   first pass is made already, and its row is left. Returns how many rows there are. */
int run_sequence(int n, long long row, int done, int n_steps, const Step *steps, int n_columns, const Column *columns,
                 int *stop, double *clock) {
  for (int k = 0; k < n; ++k, done = 0) {
    if (!done) *stop = 0;
    for (int i = 0; i < n_steps && !done; ++i) {
      void *const *m = steps[i].memory;
      const int before = *stop;
      clock[i] = now();
      if (steps[i].asked) *stop = RAISED;
      steps[i].kernel(m[0], m[1], m[2], m[3]);
      if (*stop > LOOK) return k;
      if (*stop < before) *stop = before;
    }
    if (!done) {
      clock[n_steps] = now();
      if (*stop) return k;
    }
    for (int i = 0; i < n_columns; ++i) copy(columns + i, row + k);
  }
  return n;
}
