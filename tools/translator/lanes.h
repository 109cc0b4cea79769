#define JOINED(name, variant) name##_##variant
#define NAMED(name, variant) JOINED(name, variant)
#define OF_VARIANT(name) NAMED(name, VARIANT)

/* A number of each member: one lane of a vector, which lies wherever a double may lie. */
#define lanes_LANES LANES
#undef SIDE_BY_SIDE /* members are already */
#undef SIDE_BY_SIDE_APART
#define SIDE_BY_SIDE(own)
#define SIDE_BY_SIDE_APART(own)
typedef double lanes __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef int64_t lane_bits __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef int64_t half_bits __attribute__((vector_size(4 * LANES)));
typedef int64_t quarter_bits __attribute__((vector_size(2 * LANES)));

INLINE lanes broadcast(double a) { return a - (lanes){0}; } /* less nought: a negative nought stays one */
INLINE lanes lanes_abs(lanes a) { return (lanes)((lane_bits)a & INT64_MAX); }
INLINE lanes lanes_if(bool first, lanes a, lanes b)
{
    if (first)
        return a;
    return b;
}
#if defined(__AVX512F__) && LANES == 8
/* Instructions of their own: compilers make several of what stands below, some by way of the memory. */
#include <immintrin.h>
#define CHOOSE(a, compares, b, c, d) _mm512_mask_blend_pd(_mm512_cmp_pd_mask(a, b, compares), d, c)
/* Of equals, and beside what is no number, the instruction gives the second. */
INLINE lanes max_l(lanes a, lanes b) { return _mm512_max_pd(b, a); }
INLINE lanes min_l(lanes a, lanes b) { return _mm512_min_pd(b, a); }
INLINE lanes if_less(lanes a, lanes b, lanes c, lanes d) { return CHOOSE(a, _CMP_LT_OQ, b, c, d); }
INLINE lanes if_at_most(lanes a, lanes b, lanes c, lanes d) { return CHOOSE(a, _CMP_LE_OQ, b, c, d); }
INLINE lanes lanes_root(lanes a) { return _mm512_sqrt_pd(a); }
INLINE lanes gathered(const double *p, const int64_t *places, int64_t further)
{
    return _mm512_i64gather_pd(_mm512_loadu_si512(places), p + further, 8);
}
INLINE bool all_within(lanes a, double limit)
{
    return _mm512_cmp_pd_mask(_mm512_abs_pd(a), _mm512_set1_pd(limit), _CMP_LE_OQ) == 255;
}
#else
INLINE lanes choose(lane_bits which, lanes a, lanes b)
{
    return (lanes)((which & (lane_bits)a) | (~which & (lane_bits)b));
}
INLINE lanes max_l(lanes a, lanes b) { return choose(b > a, b, a); }
INLINE lanes min_l(lanes a, lanes b) { return choose(b < a, b, a); }
INLINE lanes if_less(lanes a, lanes b, lanes c, lanes d) { return choose(a < b, c, d); }
INLINE lanes if_at_most(lanes a, lanes b, lanes c, lanes d) { return choose(a <= b, c, d); }
INLINE lanes lanes_root(lanes a)
{
    double each[LANES];
    memcpy(each, &a, sizeof each);
#ifdef PRAGMA
    PRAGMA(omp simd) /* gcc takes them one by one in large functions */
#endif
    for (int lane = 0; lane < LANES; lane++)
        each[lane] = sqrt(each[lane]);
    memcpy(&a, each, sizeof each);
    return a;
}
INLINE lanes gathered(const double *p, const int64_t *places, int64_t further)
{
    double each[LANES];
    for (int lane = 0; lane < LANES; lane++)
        each[lane] = p[places[lane] + further];
    lanes a;
    memcpy(&a, each, sizeof each);
    return a;
}
INLINE bool all_within(lanes a, double limit)
{
    /* halves of halves: a loop over the lanes takes a tenth of a sample */
    const lane_bits within = lanes_abs(a) <= broadcast(limit);
    half_bits half[2];
    quarter_bits quarter[2];
    memcpy(half, &within, sizeof half);
    half[0] &= half[1];
    memcpy(quarter, half, sizeof quarter);
    quarter[0] &= quarter[1];
    return (quarter[0][0] & quarter[0][1]) != 0;
}
#endif
