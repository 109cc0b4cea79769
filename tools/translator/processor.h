/* Which vectors this processor has, and its system keeps.  Asked here: the compilers' own function for it says no to
   everything where zig has built the library. */
#include <cpuid.h>

/* Return whether the extended features have a bit in EBX, and the system keeps the registers of a mask. */
static bool serves(unsigned feature, unsigned registers)
{
    unsigned a, b, c, d, kept;
    if (!__get_cpuid(1, &a, &b, &c, &d) || !(c & bit_OSXSAVE))
        return false;
    __asm__ volatile("xgetbv" : "=a"(kept), "=d"(d) : "c"(0));
    return (kept & registers) == registers && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & feature);
}

static bool serves_avx2(void)
{
    return serves(bit_AVX2, 0x06); /* XMM, YMM */
}

static bool serves_avx512(void)
{
    return serves(bit_AVX512F, 0xE6); /* these, the masks, and both halves of ZMM */
}
