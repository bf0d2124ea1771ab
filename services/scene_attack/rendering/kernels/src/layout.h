// Exports the layout of each structure that callers pass and the signature of each function, as the compiler sees them
// (services/scene_attack/rendering/kernels/compiled.py).
//
// STRUCTURE(S, ID, NAME, FIELD(S, a) FIELD(S, b)) and FUNCTION(f) add lines to a text table that all sources share.

#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

// The text table, a single instance in the library, and none of another library's.
__attribute__((visibility("hidden"))) std::string &layout_lines();

namespace {

// The table's name of a type; STRUCTURE gives a structure its own.
template <class T> struct Word;
template <> struct Word<void> { static std::string of() { return "void"; } };
template <> struct Word<float> { static std::string of() { return "float32"; } };
template <> struct Word<double> { static std::string of() { return "float64"; } };
template <> struct Word<int32_t> { static std::string of() { return "int32"; } };
template <> struct Word<int64_t> { static std::string of() { return "int64"; } };
template <> struct Word<uint8_t> { static std::string of() { return "uint8"; } };
template <class T> struct Word<const T> : Word<T> {};
template <class T> struct Word<T *> { static std::string of() { return Word<T>::of() + "*"; } };
template <class T, size_t n> struct Word<T[n]> {
    static std::string of() { return Word<T>::of() + "[" + std::to_string(n) + "]"; }
};

inline void field_line(const std::string &name, size_t offset, size_t size, const std::string &word) {
    layout_lines() += "field " + name + " " + std::to_string(offset) + " " + std::to_string(size) + " " + word + "\n";
}

template <class... A> struct SignatureLine {
    SignatureLine(const char *name, void (*)(A...)) {
        layout_lines() += std::string("function ") + name;
        const std::string words[] = {Word<A>::of()...};
        for (const std::string &word : words) layout_lines() += " " + word;
        layout_lines() += "\n";
    }
};

}  // namespace

#define FIELD(S, NAME) field_line(#NAME, offsetof(S, NAME), sizeof(S::NAME), Word<decltype(S::NAME)>::of());

// Parentheses around a type keep its commas together.
#define STRUCTURE(S, ID, NAME, FIELDS)                                                                                 \
    namespace {                                                                                                        \
    template <> struct Word<S> { static std::string of() { return NAME; } };                                           \
    const bool layout_of_##ID = [] {                                                                                   \
        layout_lines() += "structure " + Word<S>::of() + " " + std::to_string(sizeof(S)) + "\n";                 \
        FIELDS return true;                                                                                            \
    }();                                                                                                               \
    }

#define FUNCTION(NAME) namespace { const SignatureLine signature_of_##NAME(#NAME, &NAME); }
