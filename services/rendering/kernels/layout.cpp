// The table of the library's structures and functions (layout.h), for the caller to compare with its own.

#include "lanes.h"
#include "layout.h"

EXPORT const char *layout_table() { return LayoutTable::lines().c_str(); }
