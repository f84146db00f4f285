// How a program of the suites ends when it cannot do what it was asked.
#pragma once

#include <exception>
#include <functional>
#include <stdexcept>
#include <string>

namespace rt_tests {

// The command line is wrong: exit status 2.
struct UsageError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// A right, a resource or a file is missing: exit status 1.
struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};

void info(const std::string& line);   // "\tINFO: ..." on standard output
void warning(const std::string& line);  // "\tWARNING: ..." on standard error
void error(const std::string& line);  // "\tERROR: ..." on standard error

// What an exception says of itself.
std::string text_of(const std::exception_ptr& thrown);

// Runs the body of a program. Turns an exception into one line on standard error and an exit status.
int guarded(const std::function<int()>& body);

}  // namespace rt_tests
