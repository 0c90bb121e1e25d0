typedef int Function(const double **, double **, long long *, double *, int);
typedef void Twice(const double **, double **, const double **, double **);
typedef struct { Function *function; Twice *twice; const double **arguments; double **results; } Call;

/* From one call on; which one failed, n for none. Where there is `twice` it makes the next one too, and does not fail. */
int make_calls(int i, int n, const Call *calls, long long *iw, double *w) {
  while (i < n) {
    const Call *one = calls + i, *other = one + 1;
    if (one->twice)
      one->twice(one->arguments, one->results, other->arguments, other->results), ++i;
    else if (one->function(one->arguments, one->results, iw, w, 0) != 0)
      return i;
    ++i;
  }
  return i;
}
