// The example needs this library alone.
#include "../../../examples/own_recovery.cc"
