// What a kernel is called that is a template over the scalar S that it computes in.
#pragma once

#define TR_KERNEL_NAME(name) sizeof(S) == sizeof(float) ? "tr::" #name "<float>" : "tr::" #name "<double>"
