/* Calls functions of a library of kernels as a file of recorded calls says, and writes what they leave.

   replay LIBRARY CALLS RESULTS. All numbers are words of 64 bits; tests/helpers/kernel_recordings.py describes and
   writes the file. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
static void *library_of(const char *path) { return (void *)LoadLibraryA(path); }
static void *function_of(void *library, const char *name) { return (void *)GetProcAddress((HMODULE)library, name); }
#else
#include <dlfcn.h>
static void *library_of(const char *path) { return dlopen(path, RTLD_NOW); }
static void *function_of(void *library, const char *name) { return dlsym(library, name); }
#endif

typedef int32_t (*Kernel)(const int64_t *slots, int64_t *out);

static FILE *calls, *results;

static void stop(const char *what, const char *about) {
    fprintf(stderr, "%s: %s\n", what, about);
    exit(1);
}

static int64_t word(void) {
    int64_t value;
    if (fread(&value, 8, 1, calls) != 1)
        stop("the file ends", "calls");
    return value;
}

static void fill(void *data, int64_t size) {
    if (size && fread(data, 1, (size_t)size, calls) != (size_t)size)
        stop("the file ends", "calls");
}

static void put(const void *data, int64_t size) {
    if (size && fwrite(data, 1, (size_t)size, results) != (size_t)size)
        stop("cannot write", "results");
}

static void *room(int64_t size) {
    void *data = calloc(1, (size_t)size);
    if (!data)
        stop("no memory", "");
    return data;
}

static void replay(void *library) {
    int64_t length = word();
    char *name = room(length + 1);
    fill(name, length);
    Kernel kernel = (Kernel)(uintptr_t)function_of(library, name);
    if (!kernel)
        stop("no such function", name);
    int64_t slot_count = word(), out_count = word(), block_count = word(), address_count = word();
    int64_t link_count = word();
    int64_t *slots = room(8 * slot_count + 8), *out = room(8 * out_count + 8), *sizes = room(8 * block_count + 8);
    char **blocks = room((int64_t)sizeof(char *) * block_count + 8), **owned = room((int64_t)sizeof(char *) * block_count + 8);
    fill(slots, 8 * slot_count);
    for (int64_t k = 0; k < block_count; k++) { /* blocks lie as they did, modulo 64 bytes */
        int64_t offset = word();
        sizes[k] = word();
        owned[k] = room(sizes[k] + 128);
        blocks[k] = (char *)(((uintptr_t)owned[k] + 63) / 64 * 64) + offset;
        fill(blocks[k], sizes[k]);
    }
    for (int64_t k = 0; k < address_count; k++) {
        int64_t slot = word(), block = word();
        slots[slot] = (int64_t)(uintptr_t)(blocks[block] + word());
    }
    for (int64_t k = 0; k < link_count; k++) {
        int64_t block = word(), where = word(), other = word();
        char *target = blocks[other] + word();
        memcpy(blocks[block] + where, &target, sizeof target);
    }
    int64_t code = kernel(slots, out);
    put(&code, 8);
    put(out, 8 * out_count);
    for (int64_t k = 0; k < block_count; k++) {
        put(blocks[k], sizes[k]);
        free(owned[k]);
    }
    free(owned), free(blocks), free(sizes), free(out), free(slots), free(name);
}

int main(int argc, char **argv) {
    if (argc != 4)
        stop("usage", "replay LIBRARY CALLS RESULTS");
    void *library = library_of(argv[1]);
    if (!library)
        stop("cannot load", argv[1]);
    calls = fopen(argv[2], "rb"), results = fopen(argv[3], "wb");
    if (!calls || !results)
        stop("cannot open", argv[2]);
    for (int64_t count = word(); count > 0; count--)
        replay(library);
    return fclose(results) ? 1 : 0;
}
