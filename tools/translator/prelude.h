/* Made by tools/translator from the kernels in Python: edit those. */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__GNUC__)
#define INLINE static inline __attribute__((always_inline, unused))
/* No function: gcc takes one that only fetches for one that does nothing, and leaves it out. */
#define fetch_early(...) __builtin_prefetch(__VA_ARGS__)
#define PRAGMA(text) _Pragma(#text)
#define SIDE_BY_SIDE PRAGMA(omp simd)
#else
#define INLINE static inline
#define fetch_early(...) (void)(__VA_ARGS__)
#define SIDE_BY_SIDE
#endif
/* Which loops are made of vectors.  gcc chooses better by itself, except in kernels of short loops: there only those
   that say SIDE_BY_SIDE.  clang follows SIDE_BY_SIDE, and leaves the other loops of such a kernel scalar. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ > 10
#define SHORT_LOOPS __attribute__((optimize("vect-cost-model=very-cheap")))
#else
#define SHORT_LOOPS
#endif
#if defined(__clang__)
#define SHORT_LOOP _Pragma("clang loop vectorize(disable)")
/* Else clang hands what one loop has stored over to the next one, and makes no vectors of the first. */
#define IN_TURN __asm__ volatile ("")
#else
#define SHORT_LOOP
#define IN_TURN
#endif

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

/* As in Python: the first one where they are equal, or where one is no number. */
INLINE double max_d(double a, double b) { return b > a ? b : a; }
INLINE double min_d(double a, double b) { return b < a ? b : a; }
INLINE int64_t max_i(int64_t a, int64_t b) { return b > a ? b : a; }
INLINE int64_t min_i(int64_t a, int64_t b) { return b < a ? b : a; }
INLINE bool is_nan(double a) { return a != a; }
INLINE bool is_inf(double a) { return fabs(a) > 1.7976931348623157e308; }
INLINE bool is_finite(double a) { return fabs(a) <= 1.7976931348623157e308; }
/* Rounded down, as in Python. */
INLINE int64_t floor_div(int64_t a, int64_t b) { return a / b - ((a % b != 0) && ((a < 0) != (b < 0))); }
INLINE int64_t floor_mod(int64_t a, int64_t b)
{
    int64_t rest = a % b;
    return rest != 0 && ((rest < 0) != (b < 0)) ? rest + b : rest;
}
