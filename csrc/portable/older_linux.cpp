// Lets a library that is compiled on a newer Linux run on older ones, as wheels do: with glibc 2.28 and the libstdc++
// of GCC 8 (manylinux_2_28). Functions that are newer, or have a newer version, are defined here by those that have
// been there always; the linker takes these, which nobody else sees. Linked with TORCHRENDER_PORTABLE=1 alone
// (setup.py).
#include <pthread.h>
#include <sys/stat.h>

#include <condition_variable>
#include <cstdint>
#include <ctime>
#include <mutex>
#include <new>

#if defined(__x86_64__)
#define TR_FIRST_GLIBC "GLIBC_2.2.5"
#define TR_STAT_VERSION 1
#elif defined(__aarch64__)
#define TR_FIRST_GLIBC "GLIBC_2.17"
#define TR_STAT_VERSION 0
#endif

// What `name` was in the first glibc of this processor, as first_`name`.
#define TR_FIRST(result, name, ...)              \
    extern "C" result first_##name(__VA_ARGS__); \
    __asm__(".symver first_" #name ", " #name "@" TR_FIRST_GLIBC)

TR_FIRST(double, exp, double);
TR_FIRST(double, log, double);
TR_FIRST(double, pow, double, double);
TR_FIRST(float, expf, float);
TR_FIRST(float, logf, float);
TR_FIRST(float, powf, float, float);
TR_FIRST(void *, dlopen, const char *, int);
TR_FIRST(void *, dlsym, void *, const char *);
TR_FIRST(int, dlclose, void *);
TR_FIRST(char *, dlerror, void);
TR_FIRST(int, pthread_mutex_trylock, pthread_mutex_t *);
TR_FIRST(int, __xstat, int, const char *, struct stat *);

extern "C" {

double exp(double x) { return first_exp(x); }
double log(double x) { return first_log(x); }
double pow(double x, double y) { return first_pow(x, y); }
float expf(float x) { return first_expf(x); }
float logf(float x) { return first_logf(x); }
float powf(float x, float y) { return first_powf(x, y); }
void *dlopen(const char *path, int mode) noexcept { return first_dlopen(path, mode); }
void *dlsym(void *library, const char *name) noexcept { return first_dlsym(library, name); }
int dlclose(void *library) noexcept { return first_dlclose(library); }
char *dlerror() noexcept { return first_dlerror(); }
int pthread_mutex_trylock(pthread_mutex_t *mutex) noexcept { return first_pthread_mutex_trylock(mutex); }

// glibc 2.33: was inline before, and the kernel's structure has a number.
int stat(const char *path, struct stat *state) noexcept { return first___xstat(TR_STAT_VERSION, path, state); }

// glibc 2.30: waits until a time of any clock. Before, that of the system alone.
int pthread_cond_clockwait(pthread_cond_t *condition, pthread_mutex_t *mutex, clockid_t clock, const timespec *until) {
    constexpr int64_t second = 1000000000;
    timespec now{}, system{};
    clock_gettime(clock, &now);
    clock_gettime(CLOCK_REALTIME, &system);
    const int64_t left = (until->tv_sec - now.tv_sec) * second + (until->tv_nsec - now.tv_nsec);
    const int64_t end = system.tv_sec * second + system.tv_nsec + left;
    const timespec end_of_system{time_t(end / second), long(end % second)};
    return pthread_cond_timedwait(condition, mutex, &end_of_system);
}

// glibc 2.32: whether counts of references need not be atomic.
char __libc_single_threaded = 0;

// libstdc++ of GCC 12: copies and releases of std::exception_ptr, by what did so before they were inline.
void first_copy(void *to, const void *from) __asm__("_ZNSt15__exception_ptr13exception_ptrC1ERKS0_");
void first_destroy(void *pointer) __asm__("_ZNSt15__exception_ptr13exception_ptrD1Ev");
void add_reference(void *pointer) __asm__("_ZNSt15__exception_ptr13exception_ptr9_M_addrefEv");
void release_reference(void *pointer) __asm__("_ZNSt15__exception_ptr13exception_ptr10_M_releaseEv");

void add_reference(void *pointer) {
    void *copy;  // is never destroyed
    first_copy(&copy, pointer);
}

void release_reference(void *pointer) {
    first_destroy(pointer);
    *static_cast<void **>(pointer) = nullptr;
}

// libstdc++ of GCC 12: a newer version of condition_variable::wait, which its headers may declare differently.
void wait_on(std::condition_variable *self,
             std::unique_lock<std::mutex> &lock) __asm__("_ZNSt18condition_variable4waitERSt11unique_lockISt5mutexE");

void wait_on(std::condition_variable *self, std::unique_lock<std::mutex> &lock) {
    pthread_cond_wait(self->native_handle(), lock.mutex()->native_handle());
}
}

namespace std {

void __throw_bad_array_new_length() { throw bad_array_new_length(); }  // GCC 11

}  // namespace std
