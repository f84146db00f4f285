#include "rt_tests_support/measure/publisher.h"

#include "rcl.h"

int main(int argc, char* argv[]) { return communication::publisher_main<Rcl>(argc, argv); }
