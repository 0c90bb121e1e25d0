/* What takes most time is compiled twice: for any processor, and for those whose registers hold four numbers, which is looked at
when the library is loaded. The operations are the same in the same order: results do not depend on the processor. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#define INLINE static inline __attribute__((always_inline))
#else
#define WIDE
#define INLINE static inline
#endif
