// What a derivative has in a device's memory: which parts of a scene it is asked for, the adjoint of the film, and
// gradients or tangents.
#pragma once

#include <vector>

#include "device/adjoint_kernels.h"
#include "device/derivative_kernels.h"
#include "device/launcher.h"
#include "render.h"

namespace tr {

template <class S>
class DeviceDerivative {
public:
    // With tables on the device.
    GradientNeeds needs(Launcher &launcher, const DerivativeCall<S> &call);

    // The adjoint of an image, (results, channels), on the device where it is said to be; of two sums by wanted pixel
    // number `of`, that of the weights, null where all samples have the weight 1 in their own pixel.
    struct Adjoint {
        const S *image;
        int channels;
        bool there = false;
    };
    struct Weights {
        const double *sums;
        int of;
    };
    // The adjoint of the film's sums from that of the image.
    void begin_adjoint(Launcher &launcher, const RenderCall<S> &call, const TileSchedule &schedule,
                       const Adjoint &adjoint, const Weights &weights);
    // What samples get of it.
    AdjointGather<S> gather(const Filter &filter, const SlotColumns<S> &slots) const;

    // Gradients, zero so far; `non_finite` counts values that are left out. With `fixed_sums` every batch has a sweep
    // that measures, one that adds, and is settled then.
    // `there`: which of the call's lie on the device.
    DerivativePlaces<S> begin_gradients(Launcher &launcher, const DerivativeCall<S> &call, const OnDevice &there,
                                        uint64_t *non_finite);
    void settle(Launcher &launcher);
    // Adds them to those of the call.
    void finish_gradients(Launcher &launcher, DerivativeCall<S> &call, const OnDevice &there, int threads);
    DerivativePlaces<S> tangents(Launcher &launcher, const DerivativeCall<S> &call, const OnDevice &there,
                                 uint64_t *non_finite);

private:
    DeviceArray<int32_t> bsdfs_, shapes_, numbers_;
    DeviceArray<float> boxes_;
    DeviceArray<uint32_t> variables_;
    DeviceArray<S> image_, tangents_, vertex_tangents_[VertexArrays];
    DeviceArray<double> adjoint_, constants_, sums_, vertices_[VertexArrays];
    std::vector<DeviceArray<S>> tensors_;  // by slot
    struct Settled {
        SettleSums<S> sums;
        uint32_t n;
    };
    std::vector<DeviceArray<FixedSum<S>>> fixed_;
    std::vector<Settled> settled_;
    DeviceArray<S *> pointers_;
    DeviceArray<TensorView<S>> views_;
    HostBuffer found_;  // on its way back
    WantedPixels wanted_{};
    int channels_ = 0;  // of the adjoint
    uint32_t copies_ = 1;

    FixedSum<S> *fixed(Launcher &launcher, size_t n, uint32_t copies, double *to, S *to_texels);
    DerivativePlaces<S> places(Launcher &launcher, const DerivativeCall<S> &call, uint64_t *non_finite);
    WantedPixels wanted(Launcher &launcher, const TileSchedule &schedule, bool list);
};

}  // namespace tr
