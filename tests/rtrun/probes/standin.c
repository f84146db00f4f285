/* Libraries with the functions that probes are placed on, and a program that calls them: what ROS is not needed for.
 *
 * -DLIBRARY_tracetools and -DLIBRARY_rcl make the libraries. The program:
 *
 *     standin PER_S COUNT [FIRST [STEP [TOPIC [FORK_AT]]]]
 *
 * For each message a timer is called, and it is published and taken; then it waits to be ended. FIRST is the first
 * message's time, STEP lies between two. With message FORK_AT a child begins to do the same, with times of its own. */
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

struct endpoint { const char *implementation; void *data; const char *topic; };
struct timer_data { const uint32_t *clock; void *context; void *guard[2]; void *callback; int64_t period, last, next; };
struct timer { struct timer_data *data; };

void ros_trace_rmw_publish(const struct endpoint *, const void *, int64_t);
void ros_trace_rmw_take(const struct endpoint *, const void *, int64_t, _Bool);
int rcl_timer_call_with_info(struct timer *, void *);

#if defined(LIBRARY_tracetools)
void ros_trace_rmw_publish(const struct endpoint *e, const void *m, int64_t t)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t));
}
void ros_trace_rmw_take(const struct endpoint *e, const void *m, int64_t t, _Bool taken)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t), "r"(taken));
}
#elif defined(LIBRARY_rcl)
/* It tells Iron and later from Humble. */
int rcl_timer_set_on_reset_callback(struct timer *timer) { return timer == NULL; }
int rcl_timer_call_with_info(struct timer *timer, void *info)
{
    timer->data->next += timer->data->period;
    return info != NULL;
}
#else
int main(int argc, char **argv)
{
    long per_s = atol(argv[1]), count = atol(argv[2]);
    const char *topic = argc > 5 ? argv[5] : "/a";
    struct endpoint publisher = {"standin", NULL, topic}, subscription = {"standin", NULL, topic};
    uint32_t steady = 3;
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    int64_t period = 1000000000 / per_s, begin = at.tv_sec * 1000000000LL + at.tv_nsec;
    struct timer_data data = {.clock = &steady, .period = period, .next = begin};
    struct timer timer = {&data};
    int64_t first = argc > 3 ? atoll(argv[3]) : 0, step = argc > 4 ? atoll(argv[4]) : 1;
    long fork_at = argc > 6 ? atol(argv[6]) : -1;
    for (long i = 0; i < count; i++) {
        if (i == fork_at && fork() == 0) {
            prctl(PR_SET_PDEATHSIG, SIGKILL);
            first += count * step;
        }
        at.tv_sec = data.next / 1000000000;
        at.tv_nsec = data.next % 1000000000;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
        rcl_timer_call_with_info(&timer, NULL);
        ros_trace_rmw_publish(&publisher, NULL, first + i * step);
        ros_trace_rmw_take(&subscription, NULL, first + i * step, 1);
    }
    puts("done");
    fflush(stdout);
    pause();
    return 0;
}
#endif
