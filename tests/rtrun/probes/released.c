/* Libraries that make the calls of one release of ROS 2, and a program that uses them and writes down its own truth.
 *
 * -DLIBRARY_tracetools, -DLIBRARY_rcl and -DLIBRARY_rmw_cyclonedds_cpp make the libraries, each with -DHUMBLE or -DLYRICAL;
 * with neither they are Kilted's. Written after these sources:
 *
 *     ros2-gbp/rcl-release, release/humble/rcl 5.3.13, release/kilted/rcl 10.1.4: src/rcl/timer.c (rcl_timer_impl_s,
 *         rcl_timer_call); release/lyrical/rcl 10.4.4: src/rcl/timer_impl.h
 *     ros2-gbp/rcutils-release, release/humble/rcutils 5.1.9: src/time_unix.c (rcutils_steady_time_now)
 *     ros2/rmw_cyclonedds, humble and jazzy: rmw_cyclonedds_cpp/src/rmw_node.cpp (rmw_publish, rmw_take_int)
 *     ros2/ros2_tracing, humble: tracetools/src/tracetools.c
 *
 *     released COUNT
 *
 * Two threads have a timer of 5 ms each, whose callback publishes on one topic; the main thread takes the messages. Each
 * fiftieth message of the first one gets lost. Printed for each call: "timer PUBLISHER DUE BEGUN" on the clock of the
 * timer, and for each message "message PUBLISHER PUBLISHED TAKEN" on CLOCK_MONOTONIC. Then the program waits. */
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#if defined(HUMBLE)
#define STEADY CLOCK_MONOTONIC_RAW
#else
#define STEADY CLOCK_MONOTONIC
#endif

struct endpoint { const char *implementation; void *data; const char *topic; };
struct message { int64_t stamp, published; long publisher; };
struct timer_data {
    const uint32_t *clock;
    void *context, *guard[2], *callback;
#if defined(LYRICAL)
    void *callback_data;
#endif
    int64_t period, last, next;
};
struct timer { struct timer_data *data; };

int rcl_timer_call(struct timer *);
int rmw_publish(const struct endpoint *, struct message *, void *);
#if defined(HUMBLE)
void ros_trace_rmw_publish(const void *);
#else
void ros_trace_rmw_publish(const struct endpoint *, const void *, int64_t);
#endif
void ros_trace_rmw_take(const struct endpoint *, const void *, int64_t, _Bool);
void ros_trace_callback_start(const void *, _Bool);
void ros_trace_callback_end(const void *);

static inline int64_t now_ns(clockid_t clock)
{
    struct timespec at;
    clock_gettime(clock, &at);
    return at.tv_sec * 1000000000LL + at.tv_nsec;
}

#if defined(LIBRARY_tracetools)
#if defined(HUMBLE)
void ros_trace_rmw_publish(const void *m)
{
    __asm__ volatile("" : : "r"(m));
}
#else
void ros_trace_rmw_publish(const struct endpoint *e, const void *m, int64_t t)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t));
}
#endif
void ros_trace_rmw_take(const struct endpoint *e, const void *m, int64_t t, _Bool taken)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t), "r"(taken));
}
void ros_trace_callback_start(const void *c, _Bool is_intra)
{
    __asm__ volatile("" : : "r"(c), "r"(is_intra));
}
void ros_trace_callback_end(const void *c)
{
    __asm__ volatile("" : : "r"(c));
}
#elif defined(LIBRARY_rcl)
static int call(struct timer *timer)
{
    struct timer_data *data = timer->data;
    data->last = now_ns(STEADY);
    data->next += data->period;
    if (data->next < data->last)
        data->next += (1 + (data->last - data->next - 1) / data->period) * data->period;
    return 0;
}
#if defined(HUMBLE)
int rcl_timer_call(struct timer *timer) { return call(timer); }
#else
int rcl_timer_call_with_info(struct timer *timer, void *info) { return call(timer) + (info == timer); }
int rcl_timer_call(struct timer *timer) { return rcl_timer_call_with_info(timer, NULL); }
int rcl_timer_set_on_reset_callback(struct timer *timer) { return timer == NULL; }
#endif
#if defined(LYRICAL)
void *rcl_timer_get_callback_data(struct timer *timer) { return timer->data->callback_data; }
#endif
#elif defined(LIBRARY_rmw_cyclonedds_cpp)
/* The middleware carries the message through a pipe. */
int rmw_publish(const struct endpoint *publisher, struct message *message, void *allocation)
{
    static _Thread_local long count;
#if defined(HUMBLE)
    ros_trace_rmw_publish(message);
    message->stamp = now_ns(CLOCK_REALTIME);
#else
    message->stamp = now_ns(CLOCK_REALTIME);
    ros_trace_rmw_publish(publisher, message, message->stamp);
#endif
    if (message->publisher == 0 && ++count % 50 == 0)
        return 0;
    return write(*(int *)publisher->data, message, sizeof *message) != sizeof *message && allocation != NULL;
}
#else
struct node { struct timer timer; struct endpoint publisher; long number; int64_t *due, *begun, *published; };
static uint32_t steady = 3;
static int ends[2];
static long count;

static void *spin(void *argument)
{
    struct node *node = argument;
    struct timer_data *data = node->timer.data;
    for (long i = 0; i < count; i++) {
        int64_t left = data->next - now_ns(STEADY);
        if (left > 0)
            nanosleep(&(struct timespec){0, left}, NULL);
        node->due[i] = data->next;
        rcl_timer_call(&node->timer);
        node->begun[i] = now_ns(STEADY);
        ros_trace_callback_start(node, 0);
        struct message message = {0, now_ns(CLOCK_MONOTONIC), node->number};
        node->published[i] = message.published;
        rmw_publish(&node->publisher, &message, NULL);
        ros_trace_callback_end(node);
    }
    return NULL;
}

int main(int argc, char **argv)
{
    pthread_t threads[2];
    struct node nodes[2];
    struct endpoint subscription = {"cyclonedds", NULL, "/a"};
    count = argc > 1 ? atol(argv[1]) : 1;
    if (pipe(ends) != 0)
        return 1;
    for (long i = 0; i < 2; i++) {
        struct timer_data *data = calloc(1, sizeof *data);
        data->clock = &steady;
        data->period = 5000000;
        data->next = now_ns(STEADY) + data->period + i * 300000;
#if defined(LYRICAL)
        data->callback_data = data;
#endif
        nodes[i] = (struct node){{data}, {"cyclonedds", &ends[1], "/a"}, i, calloc(count, 8), calloc(count, 8), calloc(count, 8)};
        pthread_create(&threads[i], NULL, spin, &nodes[i]);
    }
    long left = 2 * count - count / 50;
    struct message *messages = calloc(left, sizeof *messages);
    int64_t *taken = calloc(left, sizeof *taken);
    for (long i = 0; i < left; i++) {
        if (read(ends[0], &messages[i], sizeof *messages) != sizeof *messages)
            return 1;
        taken[i] = now_ns(CLOCK_MONOTONIC);
        ros_trace_rmw_take(&subscription, &messages[i], messages[i].stamp, 1);
        ros_trace_callback_start(&subscription, 0);
        ros_trace_callback_end(&subscription);
    }
    for (long i = 0; i < 2; i++)
        pthread_join(threads[i], NULL);
    for (long i = 0; i < 2; i++)
        for (long call = 0; call < count; call++)
            printf("timer %ld %lld %lld\n", i, (long long)nodes[i].due[call], (long long)nodes[i].begun[call]);
    for (long i = 0; i < left; i++)
        printf("message %ld %lld %lld\n", messages[i].publisher, (long long)messages[i].published, (long long)taken[i]);
    puts("done");
    fflush(stdout);
    pause();
    return 0;
}
#endif
