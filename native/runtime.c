/* Runtime of the kernels: reference-counted memory, and two functions of Numba's. It runs on any processor.

   The layout of Memory is the one that kernels expect (Numba's nrt.cpp). */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#if defined(_WIN32)
#define EXPORT /* link.py lists the exported functions */
#define LOCAL
#else
#define EXPORT __attribute__((visibility("default")))
#define LOCAL __attribute__((visibility("hidden")))
#endif

typedef struct {
    size_t count;
    void (*drop)(void *data, size_t size, void *info);
    void *info;
    void *data;
    size_t size;
    void *allocator;
} Memory;

LOCAL void *NRT_Allocate(size_t size) { return malloc(size ? size : 1); }

LOCAL void NRT_Free(void *data) { free(data); }

LOCAL Memory *NRT_MemInfo_alloc_aligned(size_t size, unsigned align) {
    size_t room = sizeof(Memory) + 2 * (size_t)align;
    Memory *memory = size > SIZE_MAX - room ? NULL : malloc(room + size);
    if (!memory)
        return NULL;
    uintptr_t data = (uintptr_t)(memory + 1);
    if (align)
        data = (data + align - 1) / align * align;
    *memory = (Memory){1, NULL, NULL, (void *)data, size, NULL};
    return memory;
}

LOCAL Memory *NRT_MemInfo_alloc_safe_aligned(size_t size, unsigned align) {
    return NRT_MemInfo_alloc_aligned(size, align);
}

LOCAL Memory *NRT_MemInfo_alloc(size_t size) { return NRT_MemInfo_alloc_aligned(size, 0); }

LOCAL void NRT_MemInfo_call_dtor(Memory *memory) {
    if (memory->drop)
        memory->drop(memory->data, memory->size, memory->info);
    free(memory);
}

static void drop_list(void *data, size_t size, void *info) {
    (void)size;
    if (info)
        ((void (*)(void *))info)(data);
    free(data);
}

/* Allocate the memory of a list, as used by sorting. */
LOCAL Memory *NRT_MemInfo_new_varsize_dtor(size_t size, void (*drop)(void *)) {
    Memory *memory = malloc(sizeof(Memory));
    void *data = memory ? NRT_Allocate(size) : NULL;
    if (!data) {
        free(memory);
        return NULL;
    }
    *memory = (Memory){1, drop_list, (void *)drop, data, size, NULL};
    return memory;
}

/* Release an array that a kernel has returned. */
EXPORT void pr_release(Memory *memory) {
    if (memory && __atomic_sub_fetch(&memory->count, 1, __ATOMIC_ACQ_REL) == 0)
        NRT_MemInfo_call_dtor(memory);
}

LOCAL double numba_frexp(double x, int *exponent) {
    if (isfinite(x) && x != 0)
        return frexp(x, exponent);
    *exponent = 0;
    return x;
}

LOCAL float numba_frexpf(float x, int *exponent) {
    if (isfinite(x) && x != 0)
        return frexpf(x, exponent);
    *exponent = 0;
    return x;
}

LOCAL double numba_ldexp(double x, int exponent) { return ldexp(x, exponent); }

LOCAL float numba_ldexpf(float x, int exponent) { return ldexpf(x, exponent); }

#if defined(__x86_64__)
#include <cpuid.h>

static int has(unsigned word, unsigned bits) { return (word & bits) == bits; }

/* Return the x86-64 level of the processor, 1 to 4, limited to registers that the operating system saves. */
EXPORT int pr_level(void) {
    unsigned a, b, c, d, more_b = 0, extra_c = 0, kept = 0;
    if (!__get_cpuid(1, &a, &b, &c, &d))
        return 1;
    unsigned basic = c;
    if (__get_cpuid_count(7, 0, &a, &b, &c, &d))
        more_b = b;
    if (__get_cpuid(0x80000001, &a, &b, &c, &d))
        extra_c = c;
    if (has(basic, 1u << 27))
        __asm__ volatile("xgetbv" : "=a"(kept), "=d"(d) : "c"(0));
    /* SSE3, SSSE3, CMPXCHG16B, SSE4.1, SSE4.2, POPCNT; LAHF */
    if (!has(basic, 1u << 0 | 1u << 9 | 1u << 13 | 1u << 19 | 1u << 20 | 1u << 23) || !has(extra_c, 1u << 0))
        return 1;
    /* FMA, MOVBE, AVX, F16C; BMI1, AVX2, BMI2; LZCNT */
    if (!has(basic, 1u << 12 | 1u << 22 | 1u << 28 | 1u << 29) || !has(more_b, 1u << 3 | 1u << 5 | 1u << 8) ||
        !has(extra_c, 1u << 5) || !has(kept, 0x6))
        return 2;
    /* AVX-512 F, DQ, CD, BW, VL */
    if (!has(more_b, 1u << 16 | 1u << 17 | 1u << 28 | 1u << 30 | 1u << 31) || !has(kept, 0xe6))
        return 3;
    return 4;
}
#endif
