// Ending a measurement early, by SIGINT, SIGTERM or ROS, with what it has.
#pragma once

#include <semaphore.h>

#include <string>

namespace rt_tests {

// From now on SIGINT and SIGTERM request a stop. `wake` (may be null) is posted then, for a thread that waits on it.
void catch_stop_signals(sem_t* wake);

void request_stop() noexcept;  // on behalf of ROS
bool stop_requested() noexcept;
std::string stop_reason();  // empty when nothing was requested

}  // namespace rt_tests
