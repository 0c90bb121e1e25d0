/* Memory of a function whose parts read `given`, write `wanted` and leave for each other what is `kept`: what it is not given is 0,
what nobody wants goes nowhere. */
#define MEMORY_OF_PARTS(n_kept, n_given, longest_given, n_wanted, longest_wanted) \
  double kept[n_kept], unwanted[longest_wanted], *wanted[n_wanted];               \
  static const double zeros[longest_given];                                       \
  const double *given[n_given];                                                   \
  for (int k = 0; k < n_given; ++k) given[k] = arg[k] ? arg[k] : zeros;           \
  for (int k = 0; k < n_wanted; ++k) wanted[k] = res[k] ? res[k] : unwanted;

/* Where nearly all is arithmetic two calls at once take as long as one, each in its half of a register; compilers without such
numbers make the first one alone. */
#if defined(__GNUC__) && !defined(__TINYC__)
typedef double pair __attribute__((vector_size(16)));
#define FIRST(a) a[0]
#define OTHER(a) a[1]
#define AND_OTHER(...) __VA_ARGS__
#define VISIBLE
#else
typedef double pair;
#define FIRST(a) a
#define AND_OTHER(...)
#define VISIBLE static
#endif

#define TWO_CALLS VISIBLE void two_calls(const double **arg, double **res, const double **other_arg, double **other_res)
#define ONE_CALL(n_wanted)         \
  double *none[n_wanted] = {0};    \
  two_calls(arg, res, arg, none);

/* The memory of both: what the second one is given, or wants, stands n places later. */
#define MEMORY_OF_PAIRS(n_kept, n_given, longest_given, n_wanted, longest_wanted, n)                                        \
  pair kept[n_kept];                                                                                                        \
  double unwanted[longest_wanted], *wanted[2 * n];                                                                          \
  static const double zeros[longest_given];                                                                                 \
  const double *given[2 * n];                                                                                               \
  for (int k = 0; k < n_given; ++k) given[k] = arg[k] ? arg[k] : zeros, given[n + k] = other_arg[k] ? other_arg[k] : zeros; \
  for (int k = 0; k < n_wanted; ++k) wanted[k] = res[k] ? res[k] : unwanted;                                                \
  for (int k = 0; k < n_wanted; ++k) wanted[n + k] = other_res[k] ? other_res[k] : unwanted;
