#include "roscpp.h"

int main(int argc, char* argv[]) { return topology::main<Roscpp>(argc, argv); }
