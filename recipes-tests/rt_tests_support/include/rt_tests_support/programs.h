// What suites.yml says of the programs. programs.cpp is written by `rtgen render`, so that C++ is built without Python.
#pragma once

#include <string>
#include <vector>

#include "rt_tests_support/options.h"

namespace rt_tests {

const std::vector<Option>& all_options();

// A program of suites.yml through a middleware, with a sentence for its --help. Throws std::logic_error for one that is
// not there.
Program described(const std::string& name, const char* middleware, const char* purpose);

}  // namespace rt_tests
