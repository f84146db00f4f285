// Measures the latency of roscpp's one-shot timer.
#include "roscpp.h"

int main(int argc, char* argv[]) { return oneshot::main<Roscpp>(argc, argv); }
