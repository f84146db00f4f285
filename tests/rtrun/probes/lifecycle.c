/* Libraries with the calls of a lifecycle node, and a program that makes them: a publisher that is silent while its node is
 * not active, and another one that is not of lifecycle.
 *
 * -DLIBRARY_tracetools and -DLIBRARY_rcl make the libraries. Written after these sources:
 *
 *     ros2-gbp/rcl-release, release/lyrical/rcl_lifecycle 10.4.4: src/rcl_lifecycle.c, _trigger_transition
 *     ros2-gbp/rclcpp-release, release/lyrical/rclcpp_lifecycle 32.0.1: lifecycle_publisher.hpp (publish() returns unless
 *         activated), lifecycle_node_interface_impl.cpp, change_state
 *
 *     lifecycle
 *
 * It begins with a line, or the end, of its input. /a is published each 10 ms for a second, and taken; then the node is deactivated for five seconds, activated for a second
 * and deactivated for four seconds. /b is published each 10 ms all that time; then the program waits. */
#include <stdint.h>
#include <stdio.h>
#include <time.h>
#include <unistd.h>

struct endpoint { const char *implementation; void *data; const char *topic; };

int rcl_timer_call_with_info(void *, void *);
void ros_trace_rmw_publish(const struct endpoint *, const void *, int64_t);
void ros_trace_rmw_take(const struct endpoint *, const void *, int64_t, _Bool);
void ros_trace_rcl_lifecycle_transition(const void *, const char *, const char *);

#if defined(LIBRARY_tracetools)
void ros_trace_rmw_publish(const struct endpoint *e, const void *m, int64_t t)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t));
}
void ros_trace_rmw_take(const struct endpoint *e, const void *m, int64_t t, _Bool taken)
{
    __asm__ volatile("" : : "r"(e), "r"(m), "r"(t), "r"(taken));
}
void ros_trace_rcl_lifecycle_transition(const void *m, const char *before, const char *after)
{
    __asm__ volatile("" : : "r"(m), "r"(before), "r"(after));
}
#elif defined(LIBRARY_rcl)
/* It tells Jazzy and later from Humble. */
int rcl_timer_call_with_info(void *timer, void *info) { return timer == info; }
#else
static struct endpoint a = {"", NULL, "/a"}, b = {"", NULL, "/b"}, taker = {"", NULL, "/a"};

static void publish(const struct endpoint *publisher)
{
    struct timespec at;
    clock_gettime(CLOCK_REALTIME, &at);
    int64_t stamp = at.tv_sec * 1000000000LL + at.tv_nsec;
    ros_trace_rmw_publish(publisher, NULL, stamp);
    if (publisher == &a)
        ros_trace_rmw_take(&taker, NULL, stamp, 1);
}

static void run(int cycles, int is_active)
{
    for (int i = 0; i < cycles; i++) {
        publish(&b);
        if (is_active)
            publish(&a);
        usleep(10000);
    }
}

int main(void)
{
    rcl_timer_call_with_info(&a, NULL);
    puts("begins");
    fflush(stdout);
    getchar();
    run(100, 1);
    ros_trace_rcl_lifecycle_transition(&a, "active", "deactivating");
    ros_trace_rcl_lifecycle_transition(&a, "deactivating", "inactive");
    run(500, 0);
    ros_trace_rcl_lifecycle_transition(&a, "inactive", "activating");
    ros_trace_rcl_lifecycle_transition(&a, "activating", "active");
    run(100, 1);
    ros_trace_rcl_lifecycle_transition(&a, "active", "deactivating");
    ros_trace_rcl_lifecycle_transition(&a, "deactivating", "inactive");
    run(400, 0);
    puts("done");
    fflush(stdout);
    pause();
    return 0;
}
#endif
