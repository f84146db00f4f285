#include "rt_tests_support/measure/publisher.h"

#include "roscpp.h"

int main(int argc, char* argv[]) { return communication::publisher_main<Roscpp>(argc, argv); }
