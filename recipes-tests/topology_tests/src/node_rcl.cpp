#include "rcl.h"

int main(int argc, char* argv[]) { return topology::main<Rcl>(argc, argv); }
