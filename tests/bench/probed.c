/* A function to place any probe on, whose arguments hold what the probes read: pointers, and a topic where one is read.
 * For each line of standard input it is called 20 000 times, and the CPU time of a call is printed, in ns: of a line
 * "topic" with pointers to a topic, else with pointers to pointers. */
#include <stdio.h>
#include <time.h>

/* Not optimized it begins with a push, as the functions that are probed do; an odd address is refused. */
__attribute__((noinline, aligned(16), optimize("O0"))) void probed(void *a, void *b, void *c, void *d, void *e)
{
    __asm__ volatile("" : : "r"(a), "r"(b), "r"(c), "r"(d), "r"(e) : "memory");
}

int main(void)
{
    static char topic[256] = "/communication_tests";
    static void *topics[64], *pointers[64];
    char line[16];
    for (int k = 0; k < 64; ++k) topics[k] = topic, pointers[k] = pointers;
    while (fgets(line, sizeof line, stdin)) {
        void *first = line[0] == 't' ? topics : pointers;
        struct timespec begin, end;
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &begin);
        for (int k = 0; k < 20000; ++k) probed(first, first, topic, topic, topic);
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &end);
        printf("%.1f\n", ((end.tv_sec - begin.tv_sec) * 1e9 + end.tv_nsec - begin.tv_nsec) / 20000);
        fflush(stdout);
    }
    return 0;
}
