#include "bsdf_functions.h"

#include <mutex>

#include "core/registry.h"
#include "cpu/packet_rows.h"
#include "host/rough_transmittance.h"

namespace tr {

namespace {

template <class F>
const BsdfKernels<F> &kernels_named(const std::string &type) {
    for (int kind = 0; kind < FirstWrapper; ++kind)
        if (const auto &kernels = bsdf_kernels<F>(kind); type == kernels.model->type) return kernels;
    throw std::invalid_argument("BsdfFunctions: type: no such model: " + type);
}

template <class S>
class BsdfFunctionsOf final : public BsdfFunctions {
    using F = PacketOf<S>;
    using Rows = PacketRows<F>;
    using Table = std::shared_ptr<const std::vector<S>>;

public:
    BsdfFunctionsOf(const std::string &type, int channels, std::vector<int32_t> choices)
        : kernels_(kernels_named<F>(type)), channels_(channels), choices_(std::move(choices)) {
        if (int(choices_.size()) != kernels_.n_choices)
            throw std::invalid_argument("BsdfFunctions: choices: expected one for each choice of " + type);
    }

    const BsdfInfo &info() const override { return kernels_; }
    int channels() const override { return channels_; }

    void eval(size_t n, const Addresses &params, const Arrays &arrays) const override {
        const S *wi = in(arrays, "wi"), *wo = in(arrays, "wo");
        for_points(n, params, [&](const Rows &rows, const BsdfParameters<F> &at) {
            const Spectrum<F> one = uniform_spectrum(F(1));
            BsdfDerivative<F> d;  // of nothing: the value of any lobe
            kernels_.vjp(at, rows.vector(wi), rows.vector(wo), lobe(rows, arrays), Transport::Radiance, one, one,
                         {false, false}, d);
            rows.put(out(arrays, "value"), d.f, channels_);
        });
    }

    void pdf(size_t n, const Addresses &params, const Arrays &arrays) const override {
        const S *wi = in(arrays, "wi"), *wo = in(arrays, "wo");
        for_points(n, params, [&](const Rows &rows, const BsdfParameters<F> &at) {
            BsdfValue<F> r;
            kernels_.eval_pdf(at, rows.vector(wi), rows.vector(wo), Transport::Radiance, r);
            rows.put(out(arrays, "pdf"), r.pdf);
        });
    }

    void sample(size_t n, const Addresses &params, const Arrays &arrays) const override {
        const S *wi = in(arrays, "wi"), *from = in(arrays, "u");
        for_points(n, params, [&](const Rows &rows, const BsdfParameters<F> &at) {
            const Vec3<F> u = rows.vector(from);
            BsdfSample<F> s;
            Spectrum<F> f;
            kernels_.sample(at, rows.vector(wi), u.x, u.y, u.z, Transport::Radiance, s, f);
            rows.put(out(arrays, "wo"), s.wo);
            rows.put(out(arrays, "pdf"), s.pdf);
            rows.put(out(arrays, "eta"), s.eta);
            rows.put(out(arrays, "value"), f, channels_);
            rows.put_integers(reinterpret_cast<int32_t *>(arrays.at("lobe")), s.lobe);
            rows.put_flags(reinterpret_cast<uint8_t *>(arrays.at("delta")), s.delta);
        });
    }

    void eval_derivative(size_t n, const Addresses &params, const Arrays &arrays,
                         const Addresses &by_variable) const override {
        const S *wi = in(arrays, "wi"), *wo = in(arrays, "wo");
        const bool by_directions = arrays.count("by_wi") != 0;
        const bool by_params = std::any_of(by_variable.begin(), by_variable.end(), [](uintptr_t to) { return to; });
        if (int(by_variable.size()) != kernels_.n_variables)
            throw std::invalid_argument("BsdfFunctions: by_variable: expected one address a variable");
        for_points(n, params, [&](const Rows &rows, const BsdfParameters<F> &at) {
            const Vec3<F> from = rows.vector(wi), to = rows.vector(wo);
            const IntOf<F> lobes = lobe(rows, arrays);
            const Spectrum<F> one = uniform_spectrum(F(1));
            BsdfDerivative<F> d;
            if (by_params) {
                kernels_.vjp(at, from, to, lobes, Transport::Radiance, one, one, {BsdfNeeds::All, false}, d);
                for (size_t i = 0; i < by_variable.size(); ++i)
                    if (by_variable[i]) rows.put(reinterpret_cast<S *>(by_variable[i]), d.by_variable[i], channels_);
            }
            for (int c = 0; by_directions && c < channels_; ++c) {
                Spectrum<F> a = uniform_spectrum(F(0));
                a[c] = F(1);
                kernels_.vjp(at, from, to, lobes, Transport::Radiance, a, one, {0, true}, d);
                put_row(rows, out(arrays, "by_wi"), d.wi_bar, channels_, c);
                put_row(rows, out(arrays, "by_wo"), d.wo_bar, channels_, c);
            }
        });
    }

    void direction_derivative(size_t n, const Addresses &params, const Arrays &arrays) const override {
        if (!kernels_.direction_vjp) throw std::invalid_argument("BsdfFunctions: the model has no delta lobes");
        const size_t numbers = kernels_.turned_by >= 0 ? 1 : size_t(kernels_.n_numbers);
        const S *wi = in(arrays, "wi");
        for_points(n, params, [&](const Rows &rows, const BsdfParameters<F> &at) {
            for (int k = 0; k < 3; ++k) {
                Vec3<F> wo_bar{F(k == 0), F(k == 1), F(k == 2)}, wi_bar{F(0), F(0), F(0)};
                F number_bar[BsdfParameters<F>::MaxNumbers];
                kernels_.direction_vjp(at, rows.vector(wi), lobe(rows, arrays), wo_bar, wi_bar, number_bar);
                put_row(rows, out(arrays, "by_wi"), wi_bar, 3, k);
                for (size_t i = 0; i < numbers; ++i)
                    rows.put(out(arrays, "by_number"), number_bar[i], 3 * numbers, size_t(k) * numbers + i);
            }
        });
    }

private:
    const BsdfKernels<F> &kernels_;
    int channels_;
    std::vector<int32_t> choices_;
    mutable std::mutex mutex_;
    mutable Coating coating_;
    mutable Table table_;  // of the coating

    static const S *in(const Arrays &arrays, const char *name) { return reinterpret_cast<const S *>(arrays.at(name)); }
    static S *out(const Arrays &arrays, const char *name) { return reinterpret_cast<S *>(arrays.at(name)); }

    static IntOf<F> lobe(const Rows &rows, const Arrays &arrays) {
        return IntOf<F>(rows.index(reinterpret_cast<const uint32_t *>(arrays.at("lobe"))));
    }
    // Row k of a matrix (n, size, 3).
    static void put_row(const Rows &rows, S *to, const Vec3<F> &v, int size, int k) {
        const size_t columns = 3 * size_t(size), first = 3 * size_t(k);
        rows.put(to, v.x, columns, first), rows.put(to, v.y, columns, first + 1), rows.put(to, v.z, columns, first + 2);
    }

    // Calls visit(rows, parameters) for n points.
    template <class Visit>
    void for_points(size_t n, const Addresses &params, Visit &&visit) const {
        if (int(params.size()) != kernels_.n_continuous)
            throw std::invalid_argument("BsdfFunctions: params: expected one address a field");
        if (n == 0) return;
        const Table table = kernels_.tabulated ? table_of(params) : nullptr;
        for_rows<F>(n, [&](const Rows &rows) {
            BsdfParameters<F> at;
            load(rows, params, at);
            if (table) at.table = table->data(), at.row = IntOf<F>(0);
            visit(rows, at);
        });
    }

    // As load_parameters (core/bsdf/parameters.h) does from a scene.
    void load(const Rows &rows, const Addresses &params, BsdfParameters<F> &to) const {
        F *color = to.number, *number = to.number + SpectrumSize * kernels_.n_colors;
        F *luminance_to = number + kernels_.n_numbers;
        to.refraction = IntOf<F>(RefractsAll);
        for (int i = 0; i < kernels_.n_continuous; ++i) {
            const S *from = reinterpret_cast<const S *>(params[size_t(i)]);
            if (kernels_.use[i] != BsdfInfo::Color) {
                *number++ = rows.number(from);
                continue;
            }
            // one channel is computed as three equal ones
            const Spectrum<F> value =
                channels_ == 1 ? uniform_spectrum(rows.number(from)) : rows.spectrum(from, channels_);
            for (int c = 0; c < SpectrumSize; ++c) *color++ = value[c];
            if (i == kernels_.luminance_of) *luminance_to = luminance(value);
        }
        for (int i = 0; i < kernels_.n_choices; ++i) to.choice[i] = IntOf<F>(choices_[size_t(i)]);
    }

    // The table of a rough coating, of which there is one for all points.
    Table table_of(const Addresses &params) const {
        const CoatingFields fields(*kernels_.model);
        auto value = [&](int field) { return double(*reinterpret_cast<const S *>(params[size_t(field)])); };
        const int choice = fields.distribution - kernels_.n_continuous;
        const Coating coating = make_coating(value(fields.eta), value(fields.alpha), choices_[size_t(choice)]);
        std::lock_guard<std::mutex> lock(mutex_);
        if (!table_ || !(coating == coating_)) {
            double numbers[RoughTransmittanceSize::Numbers];
            fill_rough_transmittance(coating, numbers);
            table_ = std::make_shared<const std::vector<S>>(std::begin(numbers), std::end(numbers));
            coating_ = coating;
        }
        return table_;
    }
};

}  // namespace

std::unique_ptr<BsdfFunctions> make_bsdf_functions(const std::string &type, const std::string &dtype, int channels,
                                                   const std::vector<int32_t> &choices) {
    if (channels != 1 && channels != SpectrumSize)
        throw std::invalid_argument("BsdfFunctions: channels: expected 1 or 3, got " + std::to_string(channels));
    if (dtype == "float32") return std::make_unique<BsdfFunctionsOf<float>>(type, channels, choices);
#if !TR_HAS_PACKETS
    if (dtype == "float64") return std::make_unique<BsdfFunctionsOf<double>>(type, channels, choices);
#endif
    throw std::invalid_argument("BsdfFunctions: dtype: this module does not compute in " + dtype);
}

}  // namespace tr
