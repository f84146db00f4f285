/* Libraries with the functions of a timer whose callback is queued, and a program that does as rclcpp's EventsExecutor.
 *
 * -DLIBRARY_tracetools, -DLIBRARY_rcl and -DLIBRARY_rclcpp make the libraries. The program:
 *
 *     queued COUNT
 *
 * A thread calls a timer of 5 ms in time, COUNT times, and queues its callbacks; the main thread executes them. Each
 * tenth one takes 17 ms, so those after it are late. When each was due and began is printed at the end; then it waits. */
#include <pthread.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

struct call_info { int64_t expected, actual; };
struct data { struct call_info *info; void *count; };
struct timer_data { const uint32_t *clock; void *context; void *guard[2]; void *callback; int64_t period, last, next; };
struct timer { struct timer_data *data; };
struct timer_base { void *functions, *clock[2]; struct timer *timer; void *count; };

int rcl_timer_call_with_info(struct timer *, struct call_info *);
void ros_trace_callback_start(const void *, _Bool);
void ros_trace_callback_end(const void *);
/* The manager of timers comes first. */
void execute_ready_timer(void *, const struct timer_base *, const struct data *, void (*)(void))
    __asm__("_ZN6rclcpp12experimental13TimersManager19execute_ready_timerEPKNS_9TimerBaseERKSt10shared_ptrIvE");

#if defined(LIBRARY_tracetools)
void ros_trace_callback_start(const void *c, _Bool is_intra)
{
    __asm__ volatile("" : : "r"(c), "r"(is_intra));
}
void ros_trace_callback_end(const void *c)
{
    __asm__ volatile("" : : "r"(c));
}
#elif defined(LIBRARY_rcl)
/* It tells Iron and later from Humble. */
int rcl_timer_set_on_reset_callback(struct timer *timer) { return timer == NULL; }
int rcl_timer_call_with_info(struct timer *timer, struct call_info *info)
{
    info->expected = timer->data->next;
    timer->data->next += timer->data->period;
    return 0;
}
#elif defined(LIBRARY_rclcpp)
void execute_ready_timer(void *m, const struct timer_base *t, const struct data *d, void (*callback)(void))
{
    __asm__ volatile("" : : "r"(m), "r"(t), "r"(d));
    callback();
}
#else
static uint32_t steady = 3;
static struct timer_data timer_data = {.clock = &steady, .period = 5000000};
static struct timer timer = {&timer_data};
static struct timer_base base = {.timer = &timer};
static struct call_info *infos;
static int64_t *begun;
static long count, called, executed;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t has_called = PTHREAD_COND_INITIALIZER;

static int64_t now_ns(void)
{
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return at.tv_sec * 1000000000LL + at.tv_nsec;
}

static void *call_timer(void *unused)
{
    for (long i = 0; i < count; i++) {
        struct timespec at = {timer_data.next / 1000000000, timer_data.next % 1000000000};
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
        rcl_timer_call_with_info(&timer, &infos[i]);
        pthread_mutex_lock(&mutex);
        called++;
        pthread_cond_signal(&has_called);
        pthread_mutex_unlock(&mutex);
    }
    return unused;
}

static void callback(void)
{
    ros_trace_callback_start(&base, 0);
    begun[executed] = now_ns();
    if (executed % 10 == 0)
        usleep(17000);
    ros_trace_callback_end(&base);
}

int main(int argc, char **argv)
{
    pthread_t thread;
    count = argc > 1 ? atol(argv[1]) : 1;
    infos = calloc(count, sizeof *infos);
    begun = calloc(count, sizeof *begun);
    timer_data.next = now_ns() + timer_data.period;
    pthread_create(&thread, NULL, call_timer, NULL);
    for (executed = 0; executed < count; executed++) {
        pthread_mutex_lock(&mutex);
        while (called <= executed)
            pthread_cond_wait(&has_called, &mutex);
        pthread_mutex_unlock(&mutex);
        struct data data = {&infos[executed], NULL};
        execute_ready_timer(&base, &base, &data, callback);
    }
    for (long i = 0; i < count; i++)
        printf("%lld %lld\n", (long long)infos[i].expected, (long long)begun[i]);
    puts("done");
    fflush(stdout);
    pause();
    return 0;
}
#endif
