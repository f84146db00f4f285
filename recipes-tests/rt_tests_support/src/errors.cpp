#include "rt_tests_support/errors.h"

#include <iostream>
#include <new>
#include <stdexcept>

namespace rt_tests {

void info(const std::string& line) { std::cout << "\tINFO: " << line << std::endl; }

void warning(const std::string& line) { std::cerr << "\tWARNING: " << line << std::endl; }

void error(const std::string& line) { std::cerr << "\tERROR: " << line << std::endl; }

std::string text_of(const std::exception_ptr& thrown) {
  try {
    std::rethrow_exception(thrown);
  } catch (const std::exception& failure) {
    return failure.what();
  } catch (...) {
    return "something that is no std::exception was thrown";
  }
}

int guarded(const std::function<int()>& body) {
  try {
    return body();
  } catch (const UsageError& wrong) {
    error(wrong.what());
    return 2;
  } catch (const std::bad_alloc&) {
    error("not enough memory for so many samples; ask for fewer with -r");
  } catch (const std::length_error&) {
    error("not enough address space for so many samples; ask for fewer with -r");
  } catch (const std::exception& failure) {
    error(failure.what());
  }
  return 1;
}

}  // namespace rt_tests
