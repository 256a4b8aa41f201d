/* Stands before the C library's elementary functions, by LD_PRELOAD (studies/processors/cause.py).

   From `elementary_log` on each call of the process goes to a file, which may be a named pipe, as
   four doubles: the function's place in the lists below, two arguments (the second 0 for a function
   of one) and the result. Python code adds calls of numpy and MuJoCo by `elementary_begin` and
   `elementary_end`. Children of the process write nothing.

   ELEMENTARY_ROUNDED=1 replaces each result by one that is computed with 113 bits and rounded once,
   so that it does not depend on the processor. It is slow: some microseconds a call. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#ifdef __x86_64__ /* long double has 64 bits here */
#include <quadmath.h>
typedef __float128 quad;
#define QUAD(name) name##q
#else
#include <math.h>
typedef long double quad;
#define QUAD(name) name##l
#endif

#define ONE(DO) \
    DO(0, sin) DO(1, cos) DO(2, tan) DO(3, asin) DO(4, acos) DO(5, atan) DO(6, exp) DO(7, expm1) \
    DO(8, log) DO(9, log2) DO(10, log10) DO(11, log1p) DO(12, sinh) DO(13, cosh) DO(14, tanh)
#define TWO(DO) DO(15, atan2) DO(16, pow) DO(17, hypot)

static FILE *calls;
static long left = -1; /* calls until the signal */
static int is_rounded;
static int depth; /* of calls that Python code notes */
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;

/* Libraries whose own calls are not noted: a sort of numpy may call log2, or not. */
static const char *const LEFT_OUT[] = {"/_multiarray_umath", "/libmujoco"};
static char *first_of[2], *last_of[2];

static void forked(void) { calls = NULL; }

__attribute__((constructor)) static void begin(void)
{
    is_rounded = getenv("ELEMENTARY_ROUNDED") != NULL;
    pthread_atfork(NULL, NULL, forked);
}

/* Write the calls from here on to a file; SIGUSR2 at call `at`, never if that is negative. */
int elementary_log(const char *path, long at)
{
    char line[4096], *first, *last;
    FILE *maps = fopen("/proc/self/maps", "r");
    while (maps != NULL && fgets(line, sizeof line, maps) != NULL)
        for (int k = 0; k < 2; k++)
            if (strstr(line, LEFT_OUT[k]) != NULL
                && sscanf(line, "%p-%p", (void **)&first, (void **)&last) == 2) {
                first_of[k] = first_of[k] == NULL ? first : first_of[k];
                last_of[k] = last;
            }
    if (maps != NULL)
        fclose(maps);
    left = at;
    calls = fopen(path, "wb");
    return calls == NULL || setvbuf(calls, NULL, _IOFBF, 1 << 18);
}

static int is_noted(void *caller)
{
    for (int k = 0; k < 2; k++)
        if ((char *)caller >= first_of[k] && (char *)caller < last_of[k])
            return 0;
    return depth == 0;
}

static void note(double place, double x, double y, double result)
{
    double call[4] = {place, x, y, result};
    if (calls == NULL)
        return;
    pthread_mutex_lock(&lock);
    if (fwrite(call, sizeof call, 1, calls) != 1)
        _exit(0); /* the reader has seen enough */
    pthread_mutex_unlock(&lock);
    if (left >= 0 && left-- == 0)
        raise(SIGUSR2);
}

/* From here on calls of this library are part of a call that Python code notes. */
void elementary_begin(void) { depth++; }

/* The end of such a call: what it got and gave, as digests. */
void elementary_end(int place, const void *got, const void *gave)
{
    double x, result;
    memcpy(&x, got, sizeof x);
    memcpy(&result, gave, sizeof result);
    if (--depth == 0)
        note(place, x, 0.0, result);
}

#define OF_ONE(place, name) \
    double name(double x) \
    { \
        static double (*own)(double); \
        double result; \
        if (own == NULL) \
            own = (double (*)(double))dlsym(RTLD_NEXT, #name); \
        result = is_rounded ? (double)QUAD(name)((quad)x) : own(x); \
        if (is_noted(__builtin_return_address(0))) \
            note(place, x, 0.0, result); \
        return result; \
    }
#define OF_TWO(place, name) \
    double name(double x, double y) \
    { \
        static double (*own)(double, double); \
        double result; \
        if (own == NULL) \
            own = (double (*)(double, double))dlsym(RTLD_NEXT, #name); \
        result = is_rounded ? (double)QUAD(name)((quad)x, (quad)y) : own(x, y); \
        if (is_noted(__builtin_return_address(0))) \
            note(place, x, y, result); \
        return result; \
    }
ONE(OF_ONE)
TWO(OF_TWO)

/* What gcc makes of a sine and a cosine of one angle. */
void sincos(double x, double *sine, double *cosine)
{
    *sine = sin(x);
    *cosine = cos(x);
}
