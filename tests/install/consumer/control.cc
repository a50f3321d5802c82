// The example needs only this library.
#include "../../../examples/own_recovery.cc"
