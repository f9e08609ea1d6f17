#include "device_derivative.h"

#include <algorithm>
#include <array>

#include "device_batch.h"
#include "host/parallel.h"

namespace tr {

namespace {

constexpr size_t MostOfCopies = size_t(16) << 20;  // bytes

template <class T>
T *zeros(Launcher &launcher, DeviceArray<T> &array, size_t n) {
    array.reserve(launcher, n);
    clear(launcher, array.get(), n);
    return array.get();
}

template <class S>
std::array<size_t, VertexArrays> numbers_of_vertices(const DerivativeCall<S> &call) {
    const GeometrySizes &sizes = call.geometry_sizes;
    return {sizes.positions, sizes.normals, sizes.texcoords};
}

}  // namespace

template <class S>
GradientNeeds DeviceDerivative<S>::needs(Launcher &launcher, const DerivativeCall<S> &call) {
    GradientNeeds r = call.gradient_needs();
    if (r.bsdfs) bsdfs_.upload(launcher, call.bsdfs.data(), call.bsdfs.size()), r.bsdfs = bsdfs_.get();
    if (r.boxes) boxes_.upload(launcher, r.boxes, size_t(r.n_boxes) * 6), r.boxes = boxes_.get();
    if (r.variables) {
        variables_.upload(launcher, call.variables.data(), call.variables.size());
        r.variables = variables_.get();
    }
    return r;
}

template <class S>
WantedPixels DeviceDerivative<S>::wanted(Launcher &launcher, const TileSchedule &schedule, bool list) {
    if (!list) return {schedule.rect(), nullptr};
    Rect around{INT32_MAX, INT32_MAX, INT32_MIN, INT32_MIN};
    for (size_t i = 0; i < schedule.n_targets(); ++i) {
        const Pixel at = schedule.target(i);
        around.y0 = std::min(around.y0, at.y), around.x0 = std::min(around.x0, at.x);
        around.y1 = std::max(around.y1, at.y + 1), around.x1 = std::max(around.x1, at.x + 1);
    }
    if (schedule.n_targets() == 0) around = {0, 0, 0, 0};
    std::vector<int32_t> numbers(size_t(around.height()) * size_t(around.width()), -1);
    for (size_t i = 0; i < schedule.n_targets(); ++i) {
        const Pixel at = schedule.target(i);
        numbers[size_t(at.y - around.y0) * size_t(around.width()) + size_t(at.x - around.x0)] = int32_t(i);
    }
    numbers_.upload(launcher, numbers.data(), numbers.size());
    return {around, numbers_.get()};
}

template <class S>
void DeviceDerivative<S>::begin_adjoint(Launcher &launcher, const RenderCall<S> &call, const TileSchedule &schedule,
                                        const Adjoint &adjoint, const Weights &weights) {
    const auto channels = size_t(adjoint.channels);
    const S *image = adjoint.image;
    std::vector<S> by_target;
    if (call.pixels) {  // one that was asked for twice has two results
        by_target.assign(schedule.n_targets() * channels, 0.f);
        for (size_t i = 0; i < schedule.n_results(); ++i)
            for (size_t c = 0; c < channels; ++c)
                by_target[schedule.target_of(i) * channels + c] += image[i * channels + c];
        image = by_target.data();
    }
    image_.take(launcher, image, schedule.n_targets() * channels, adjoint.there);
    adjoint_.reserve(launcher, schedule.n_targets() * channels);
    wanted_ = wanted(launcher, schedule, call.pixels != nullptr), channels_ = adjoint.channels;
    launcher.run(DivideAdjoint<S>{image_.get(), int32_t(channels), weights.sums, weights.of, double(schedule.spp()),
                                  adjoint_.get()},
                 uint32_t(schedule.n_targets()));
}

template <class S>
AdjointGather<S> DeviceDerivative<S>::gather(const Filter &filter, const SlotColumns<S> &slots) const {
    const SampleColumns<S> samples{slots.pixel, slots.row, slots.column, slots.sample, slots.film_x, slots.film_y};
    return {filter, std::min(filter.reach(), MaxReach), channels_, wanted_, adjoint_.get(), samples};
}

// Sums that are settled with those at `to` or `to_texels`.
template <class S>
FixedSum<S> *DeviceDerivative<S>::fixed(Launcher &launcher, size_t n, uint32_t copies, double *to, S *to_texels) {
    const size_t number = settled_.size();
    if (fixed_.size() <= number) fixed_.resize(number + 1);
    FixedSum<S> *from = zeros(launcher, fixed_[number], n * copies);
    settled_.push_back({{from, copies, to, to_texels}, uint32_t(n)});
    return from;
}

template <class S>
void DeviceDerivative<S>::settle(Launcher &launcher) {
    for (const Settled &each : settled_) launcher.run(each.sums, each.n);
}

template <class S>
DerivativePlaces<S> DeviceDerivative<S>::begin_gradients(Launcher &launcher, const DerivativeCall<S> &call,
                                                         const OnDevice &there, uint64_t *non_finite) {
    settled_.clear();
    if (!call.fixed_sums) fixed_.clear();  // they are large
    const size_t size = call.fixed_sums ? sizeof(FixedSum<S>) : sizeof(double), n = call.n_constants;
    const size_t room = MostOfCopies / (size * std::max<size_t>(1, n));
    for (copies_ = launcher.gradient_copies(); copies_ > 1 && copies_ > room;) copies_ /= 2;
    DerivativePlaces<S> r = places(launcher, call, non_finite);
    r.fixed = call.fixed_sums, r.copies = copies_;
    double *const sums = zeros(launcher, sums_, n);
    r.constants = r.fixed ? reinterpret_cast<double *>(fixed(launcher, n, copies_, sums, nullptr))
                          : zeros(launcher, constants_, n * copies_);
    std::vector<S *> pointers(call.gradients.size(), nullptr);
    if (tensors_.size() < pointers.size()) tensors_.resize(pointers.size());
    for (size_t i = 0; i < pointers.size(); ++i) {
        const auto texels = size_t(call.sizes[i]);
        if (!call.gradients[i] || texels == 0) continue;
        tensors_[i].reserve(launcher, texels);
        pointers[i] = tensors_[i].get();
        if (there.slot(i))
            launcher.copy(pointers[i], call.gradients[i], texels * sizeof(S));
        else
            clear(launcher, pointers[i], texels);
        if (r.fixed) pointers[i] = reinterpret_cast<S *>(fixed(launcher, texels, 1, nullptr, pointers[i]));
    }
    pointers_.upload(launcher, pointers.data(), pointers.size());
    r.tensors = pointers_.get();
    const auto of_vertices = numbers_of_vertices(call);
    for (size_t k = 0; k < VertexArrays; ++k) {
        if (of_vertices[k] == 0) continue;
        r.vertices[k] = zeros(launcher, vertices_[k], of_vertices[k]);
        if (r.fixed)
            r.vertices[k] = reinterpret_cast<double *>(fixed(launcher, of_vertices[k], 1, r.vertices[k], nullptr));
    }
    return r;
}

// What both modes have.
template <class S>
DerivativePlaces<S> DeviceDerivative<S>::places(Launcher &launcher, const DerivativeCall<S> &call,
                                                uint64_t *non_finite) {
    DerivativePlaces<S> r{};
    shapes_.upload(launcher, call.shapes.data(), call.shapes.size());
    r.copies = 1, r.matrices = call.matrices, r.shape_wanted = shapes_.get(), r.non_finite = non_finite;
    return r;
}

template <class S>
void DeviceDerivative<S>::finish_gradients(Launcher &launcher, DerivativeCall<S> &call, const OnDevice &there,
                                           int threads) {
    size_t most = 1;
    for (size_t i = 0; i < call.gradients.size(); ++i)
        if (call.gradients[i] && !there.slot(i)) most = std::max(most, size_t(call.sizes[i]));
    auto *found = static_cast<S *>(found_.reserve(launcher, most * sizeof(S)));
    call.sums.reset(call.n_constants, call.geometry_sizes);
    // Nothing that can fail for lack of memory is behind this: tensors of PyTorch's on the device are not added to
    // before.
    if (!call.fixed_sums) launcher.run(SumCopies{constants_.get(), copies_, sums_.get()}, uint32_t(call.n_constants));
    sums_.download(call.sums.constants.data(), call.n_constants);
    std::vector<double> *const to_vertices[] = {&call.sums.positions, &call.sums.normals, &call.sums.texcoords};
    for (int k = 0; k < VertexArrays; ++k) vertices_[k].download(to_vertices[k]->data(), to_vertices[k]->size());
    for (size_t i = 0; i < call.gradients.size(); ++i) {
        const auto n = size_t(call.sizes[i]);
        S *to = call.gradients[i];
        if (!to || n == 0) continue;
        if (there.slot(i)) {
            launcher.copy(to, tensors_[i].get(), n * sizeof(S));
            continue;
        }
        tensors_[i].download(found, n);
        for_ranges(n, threads, [&](size_t begin, size_t end, int) {
            for (size_t k = begin; k < end; ++k) to[k] += found[k];
        });
    }
    launcher.synchronize();
}

template <class S>
DerivativePlaces<S> DeviceDerivative<S>::tangents(Launcher &launcher, const DerivativeCall<S> &call,
                                                  const OnDevice &there, uint64_t *non_finite) {
    // (those of the matrices of shapes are there where something moves)
    tangents_.upload(launcher, call.tangent.constants, call.needs.geometry ? call.n_constants : call.matrices);
    std::vector<TensorView<S>> views(call.tangent.tensors, call.tangent.tensors + call.sizes.size());
    if (tensors_.size() < views.size()) tensors_.resize(views.size());
    for (size_t i = 0; i < views.size(); ++i) {
        views[i].base = nullptr;
        if (!views[i].data) continue;
        tensors_[i].take(launcher, views[i].data, size_t(call.sizes[i]), there.slot(i));
        views[i].data = tensors_[i].get();
    }
    views_.upload(launcher, views.data(), views.size());
    DerivativePlaces<S> r = places(launcher, call, non_finite);
    r.forward = true, r.tangent = {tangents_.get(), views_.get()};
    const auto of_vertices = numbers_of_vertices(call);
    for (size_t k = 0; k < VertexArrays; ++k) {
        if (!call.vertex_tangent[k]) continue;
        vertex_tangents_[k].upload(launcher, call.vertex_tangent[k], of_vertices[k]);
        r.vertex_tangent[k] = vertex_tangents_[k].get();
    }
    return r;
}

template class DeviceDerivative<float>;
template class DeviceDerivative<double>;

}  // namespace tr
