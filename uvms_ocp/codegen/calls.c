typedef int Function(const double **, double **, long long *, double *, int);
typedef struct { Function *function; const double **arguments; double **results; } Call;

/* From one call on; which one failed, n for none. */
int make_calls(int i, int n, const Call *calls, long long *iw, double *w) {
  while (i < n && calls[i].function(calls[i].arguments, calls[i].results, iw, w, 0) == 0) ++i;
  return i;
}
