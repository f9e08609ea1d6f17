// Threads that work at once: those of the OpenMP that PyTorch runs its own loops with, where it is known.
//
// After a loop of PyTorch its threads spin for some milliseconds, waiting for the next one. Beside them others would
// have to share the processors; as members of the team they begin at once, and no thread has to be made.
#pragma once

#include <cstdint>
#include <functional>

namespace tr {

// Of GNU's OpenMP: GOMP_parallel, omp_get_thread_num, omp_get_num_threads. Null: threads of our own.
struct OpenMp {
    void (*parallel)(void (*)(void *), void *, unsigned, unsigned) = nullptr;
    int (*number)() = nullptr;
    int (*size)() = nullptr;
};
void use_openmp(const OpenMp &functions);

// Calls body(0) .. body(n - 1), each on a thread of its own, the first on the calling one, which before calls absent(k)
// for those for which no thread is to be had. Nothing may be thrown.
using Member = std::function<void(int)>;
void run_team(int n, const Member &body, const Member &absent);

}  // namespace tr
