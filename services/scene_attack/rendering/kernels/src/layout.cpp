// Returns the table of the library's structures and functions (layout.h), which callers compare with their own.

#include "lanes.h"
#include "layout.h"

std::string &layout_lines() {
    static std::string text;
    return text;
}

EXPORT const char *layout_table() { return layout_lines().c_str(); }
