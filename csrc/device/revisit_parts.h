// The functions of the core that a kernel calls which goes over vertices of a tape again, besides those in
// core_parts.h.
#pragma once

#if defined(__CUDACC_RTC__)
#include "core/adjoint/revisit.cpp"
#endif
