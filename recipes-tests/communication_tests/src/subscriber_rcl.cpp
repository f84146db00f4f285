#include "rt_tests_support/measure/subscriber.h"

#include "rcl.h"

int main(int argc, char* argv[]) { return communication::subscriber_main<Rcl>(argc, argv); }
