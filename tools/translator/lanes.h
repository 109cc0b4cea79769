#define lanes_LANES LANES
#undef SIDE_BY_SIDE /* members are already */
#define SIDE_BY_SIDE

/* Vectors of the processor, which lie wherever a double may lie: of wider ones gcc keeps each in the memory. */
#if defined(__AVX__)
#include <immintrin.h>
#endif
#define TWO(of) of(0), of(1)
#define FOUR(of) TWO(of), of(2), of(3)
#define EIGHT(of) FOUR(of), of(4), of(5), of(6), of(7)
#if defined(__AVX512F__)
#define WIDTH 8
#define EACH EIGHT
#define PARTS TWO
#elif defined(__AVX__)
#define WIDTH 4
#define EACH FOUR
#define PARTS FOUR
#else
#define WIDTH 2
#define EACH TWO
#define PARTS EIGHT
#endif
typedef double few __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));
typedef int64_t few_bits __attribute__((vector_size(8 * WIDTH), aligned(8), may_alias));

/* A number of each member. */
typedef struct __attribute__((may_alias)) { few part[LANES / WIDTH]; } lanes;
#if LANES != 16
#error PARTS names those of sixteen
#endif

/* One by one: the processors' own instruction takes longer. */
#define PLACED(i) p[places[i]]
INLINE few few_gathered(const double *p, const int64_t *places)
{
    return (few){ EACH(PLACED) };
}
INLINE few few_equal(double a) { return a - (few){0}; } /* less nought: a negative nought stays one */
INLINE few few_abs(few a) { return (few)((few_bits)a & INT64_MAX); }
#if defined(__AVX512F__)
/* Instructions of their own: compilers make several of what stands below, some by way of the memory. */
#define CHOOSE(a, compares, b, c, d) _mm512_mask_blend_pd(_mm512_cmp_pd_mask(a, b, compares), d, c)
INLINE few few_if_less(few a, few b, few c, few d) { return CHOOSE(a, _CMP_LT_OQ, b, c, d); }
INLINE few few_if_at_most(few a, few b, few c, few d) { return CHOOSE(a, _CMP_LE_OQ, b, c, d); }
/* Of equals, and beside what is no number, the instruction gives the second. */
INLINE few few_max(few a, few b) { return _mm512_max_pd(b, a); }
INLINE few few_min(few a, few b) { return _mm512_min_pd(b, a); }
INLINE few few_root(few a) { return _mm512_sqrt_pd(a); }
INLINE bool few_within(few a, double limit)
{
    return _mm512_cmp_pd_mask(_mm512_abs_pd(a), _mm512_set1_pd(limit), _CMP_LE_OQ) == 255;
}
#elif defined(__AVX__)
#define CHOOSE(a, compares, b, c, d) _mm256_blendv_pd(d, c, _mm256_cmp_pd(a, b, compares))
INLINE few few_if_less(few a, few b, few c, few d) { return CHOOSE(a, _CMP_LT_OQ, b, c, d); }
INLINE few few_if_at_most(few a, few b, few c, few d) { return CHOOSE(a, _CMP_LE_OQ, b, c, d); }
INLINE few few_max(few a, few b) { return _mm256_max_pd(b, a); }
INLINE few few_min(few a, few b) { return _mm256_min_pd(b, a); }
INLINE few few_root(few a) { return _mm256_sqrt_pd(a); }
INLINE bool few_within(few a, double limit)
{
    return _mm256_movemask_pd(_mm256_cmp_pd(few_abs(a), _mm256_set1_pd(limit), _CMP_LE_OQ)) == 15;
}
#else
INLINE few few_chosen(few_bits which, few a, few b)
{
    return (few)((which & (few_bits)a) | (~which & (few_bits)b));
}
INLINE few few_if_less(few a, few b, few c, few d) { return few_chosen(a < b, c, d); }
INLINE few few_if_at_most(few a, few b, few c, few d) { return few_chosen(a <= b, c, d); }
INLINE few few_max(few a, few b) { return few_chosen(b > a, b, a); }
INLINE few few_min(few a, few b) { return few_chosen(b < a, b, a); }
INLINE few few_root(few a)
{
    double each[WIDTH];
    memcpy(each, &a, sizeof each);
#ifdef PRAGMA
    PRAGMA(omp simd) /* gcc takes them one by one in large functions */
#endif
    for (int lane = 0; lane < WIDTH; lane++)
        each[lane] = sqrt(each[lane]);
    memcpy(&a, each, sizeof each);
    return a;
}
INLINE bool few_within(few a, double limit)
{
    const few_bits within = few_abs(a) <= few_equal(limit);
    return (within[0] & within[1]) != 0;
}
#endif

#define SUM(i) a.part[i] + b.part[i]
#define DIFFERENCE(i) a.part[i] - b.part[i]
#define PRODUCT(i) a.part[i] * b.part[i]
#define QUOTIENT(i) a.part[i] / b.part[i]
#define MINUS(i) -a.part[i]
#define EQUAL(i) few_equal(a)
#define ABS(i) few_abs(a.part[i])
#define ROOT(i) few_root(a.part[i])
#define MAX(i) few_max(a.part[i], b.part[i])
#define MIN(i) few_min(a.part[i], b.part[i])
#define IF_LESS(i) few_if_less(a.part[i], b.part[i], c.part[i], d.part[i])
#define IF_AT_MOST(i) few_if_at_most(a.part[i], b.part[i], c.part[i], d.part[i])
#define GATHERED(i) few_gathered(p + further, places + (i) * WIDTH)
INLINE lanes sum(lanes a, lanes b) { return (lanes){ { PARTS(SUM) } }; }
INLINE lanes difference(lanes a, lanes b) { return (lanes){ { PARTS(DIFFERENCE) } }; }
INLINE lanes product(lanes a, lanes b) { return (lanes){ { PARTS(PRODUCT) } }; }
INLINE lanes quotient(lanes a, lanes b) { return (lanes){ { PARTS(QUOTIENT) } }; }
INLINE lanes minus(lanes a) { return (lanes){ { PARTS(MINUS) } }; }
INLINE lanes broadcast(double a) { return (lanes){ { PARTS(EQUAL) } }; }
INLINE lanes lanes_abs(lanes a) { return (lanes){ { PARTS(ABS) } }; }
INLINE lanes lanes_root(lanes a) { return (lanes){ { PARTS(ROOT) } }; }
INLINE lanes max_l(lanes a, lanes b) { return (lanes){ { PARTS(MAX) } }; }
INLINE lanes min_l(lanes a, lanes b) { return (lanes){ { PARTS(MIN) } }; }
INLINE lanes if_less(lanes a, lanes b, lanes c, lanes d) { return (lanes){ { PARTS(IF_LESS) } }; }
INLINE lanes if_at_most(lanes a, lanes b, lanes c, lanes d) { return (lanes){ { PARTS(IF_AT_MOST) } }; }
INLINE lanes gathered(const double *p, const int64_t *places, int64_t further)
{
    return (lanes){ { PARTS(GATHERED) } };
}
#define fetch_lanes(p) (fetch_early(p), fetch_early((const char *)(p) + 64)) /* two lines of the cache */
INLINE lanes lanes_if(bool first, lanes a, lanes b)
{
    if (first)
        return a;
    return b;
}
INLINE bool all_within(lanes a, double limit)
{
    for (int i = 0; i < LANES / WIDTH; i++)
        if (!few_within(a.part[i], limit))
            return false;
    return true;
}
