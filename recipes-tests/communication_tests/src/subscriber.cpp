#include "rt_tests_support/measure/subscriber.h"

#include "roscpp.h"

int main(int argc, char* argv[]) { return communication::subscriber_main<Roscpp>(argc, argv); }
