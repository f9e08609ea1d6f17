// What a derivative has in a device's memory: which parts of a scene it is asked for, the adjoint of the film, and
// gradients or tangents.
#pragma once

#include <vector>

#include "device/adjoint_kernels.h"
#include "device/derivative_kernels.h"
#include "device/launcher.h"
#include "render.h"

namespace tr {

class DeviceDerivative {
public:
    // std::invalid_argument for what is not there, see DevicePaths.
    static void check(const DerivativeCall<float> &call);

    // With tables on the device.
    GradientNeeds needs(Launcher &launcher, const DerivativeCall<float> &call);

    // The adjoint of the film's sums from that of the image; `sums`: of alpha and weights by wanted pixel, null with
    // filters that reach no other pixel.
    void begin_adjoint(Launcher &launcher, const RenderCall<float> &call, const TileSchedule &schedule,
                       const float *image, const double *sums);
    void collect(Launcher &launcher, const RenderCall<float> &call, const SlotColumns<float> &slots, uint32_t n);

    // Gradients, zero so far; `non_finite` counts values that are left out. With `fixed_sums` every batch has a sweep
    // that measures, one that adds, and is settled then.
    DerivativePlaces begin_gradients(Launcher &launcher, const DerivativeCall<float> &call, uint64_t *non_finite);
    void settle(Launcher &launcher);
    // Adds them to those of the call.
    void finish_gradients(Launcher &launcher, DerivativeCall<float> &call, int threads);
    DerivativePlaces tangents(Launcher &launcher, const DerivativeCall<float> &call, uint64_t *non_finite);

private:
    DeviceArray<int32_t> bsdfs_, shapes_, numbers_;
    DeviceArray<float> image_, tangents_, vertex_tangents_[VertexArrays];
    DeviceArray<double> adjoint_, constants_, sums_, vertices_[VertexArrays];
    std::vector<DeviceArray<float>> tensors_;  // by slot
    struct Settled {
        SettleSums sums;
        uint32_t n;
    };
    std::vector<DeviceArray<FixedSum>> fixed_;
    std::vector<Settled> settled_;
    DeviceArray<float *> pointers_;
    DeviceArray<TensorView<float>> views_;
    HostBuffer found_;  // on its way back
    WantedPixels wanted_{};
    uint32_t copies_ = 1;

    FixedSum *fixed(Launcher &launcher, size_t n, uint32_t copies, double *to, float *to_texels);
    DerivativePlaces places(Launcher &launcher, const DerivativeCall<float> &call, uint64_t *non_finite);
    WantedPixels wanted(Launcher &launcher, const TileSchedule &schedule, bool list);
};

}  // namespace tr
