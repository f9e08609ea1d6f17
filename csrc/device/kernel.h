// Kernels are functors: what one has as members are its parameters, and its call operator does the work of one item.
//
//     struct AddOne {
//         static constexpr const char *Name = "tr::AddOne", *Header = "device/add_one.h";
//         float *numbers;
//         TR_HD void operator()(uint32_t i) const { numbers[i] += 1; }
//         template <class Visit>
//         void for_pointers(Visit &&visit) const { visit(numbers); }
//     };
//
// A device compiles the header and gets the members byte by byte; the host calls the same function in a loop. Items of
// a launch run in any order, also at once. Pointers are of the device's memory, or null; for_pointers names them all.
//
// One with `static constexpr Knowledge Knows` is compiled for a scene. One with a type `Shared` has blocks of threads
// as items, which share one of it: see block.h. One has `bool adds() const` if its items may add floating-point
// numbers to the same places (`accumulate`), which threads of a host cannot do at once.
#pragma once

#include <functional>
#include <type_traits>

#include "block.h"
#include "core/math/config.h"
#include "knowledge.h"

namespace tr {

template <class K, class = void>
struct KnowledgeOf : std::integral_constant<Knowledge, Knowledge::Nothing> {};
template <class K>
struct KnowledgeOf<K, std::void_t<decltype(K::Knows)>> : std::integral_constant<Knowledge, K::Knows> {};

template <class K, class = void>
struct AddsTogether : std::false_type {};
template <class K>
struct AddsTogether<K, std::void_t<decltype(&K::adds)>> : std::true_type {};

// What launchers know of a functor.
struct Kernel {
    const char *name, *header;  // as code says it in the namespace of all; a path below the folder of the sources
    size_t size, alignment;
    void (*item)(const void *functor, uint32_t i);
    void (*pointers)(const void *functor, const std::function<void(const void *)> &visit);
    Knowledge knows;
    bool blocks;  // its items are blocks of threads
    bool (*adds)(const void *functor);
};

template <class K>
const Kernel &kernel_of() {
    static_assert(std::is_trivially_copyable_v<K> && std::is_standard_layout_v<K>, "members are copied as bytes");
    static_assert(sizeof(K) <= 4000, "parameters of a kernel have 4 KiB");
    static const Kernel kernel{
        K::Name,
        K::Header,
        sizeof(K),
        alignof(K),
        [](const void *functor, uint32_t i) {
            const K &k = *static_cast<const K *>(functor);
            if constexpr (IsBlockKernel<K>::value) {
                typename K::Shared shared;
                k(Block<typename K::Shared>{shared, i}, i);
            } else {
                k(i);
            }
        },
        [](const void *functor, const std::function<void(const void *)> &visit) {
            static_cast<const K *>(functor)->for_pointers([&](const void *p) { visit(p); });
        },
        KnowledgeOf<K>::value,
        IsBlockKernel<K>::value,
        [](const void *functor) {
            if constexpr (AddsTogether<K>::value)
                return static_cast<const K *>(functor)->adds();
            else
                return functor == nullptr;  // never
        },
    };
    return kernel;
}

}  // namespace tr
