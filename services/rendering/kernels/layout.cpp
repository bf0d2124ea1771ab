// Returns the table of the library's structures and functions (layout.h), which callers compare with their own.

#include "lanes.h"
#include "layout.h"

EXPORT const char *layout_table() { return LayoutTable::lines().c_str(); }
