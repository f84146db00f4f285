// The gnuplot log, as the 2014 programs write it.
#pragma once

#include <string>
#include <vector>

#include "rt_tests_support/summary.h"

namespace rt_tests {

enum class Plot {
  oneshot,        // x from 1 to at least 400 us; negative bins as comments after the others
  cyclic,         // x symmetrical, at least 200 us; negative bins first
  communication,  // x from 1 us; negative bins as comments after the others
};

// `output` is the name without ".jpg"; `comments` is the summary, one line each.
std::string gnuplot_log(Plot plot, const std::string& title, const std::string& output, const Series& series,
                        const std::vector<std::string>& comments);

std::string machine_title();  // "<node> <system> <release>"

}  // namespace rt_tests
