// Python's marshal format, version 2: https://github.com/python/cpython/blob/main/Python/marshal.c. A byte that tells
// the type, then numbers in little endian; long integers in digits of 15 bits; a dict ends with a zero.
#include <cstring>

#include "value.h"

namespace tr {

class MarshalReader {
public:
    MarshalReader(const char *bytes, size_t size) : at_(bytes), end_(bytes + size) {}

    Value read() {
        switch (const char type = *take(1)) {
            case 'N':
                return {};
            case 'T':
                return true;
            case 'F':
                return false;
            case 'i':
                return number<int32_t>();
            case 'l':
                return long_integer();
            case 'g':
                return number<double>();
            case 'u':
            case 't':
                return text();
            case 's':
                return Bytes{text()};
            case '(':
            case '[':
                return list();
            case '{':
                return dict();
            default:
                throw TypeError(std::string("a value of a type that cannot be passed: ") + type);
        }
    }

private:
    const char *take(size_t n) {
        if (size_t(end_ - at_) < n) throw TypeError("the message ends too early");
        const char *here = at_;
        at_ += n;
        return here;
    }

    template <class T>
    T number() {
        T x;
        std::memcpy(&x, take(sizeof(T)), sizeof(T));
        return x;
    }

    Value long_integer() {
        const auto digits = number<int32_t>();
        uint64_t size = 0;
        for (int i = 0; i < std::abs(digits); ++i) {
            const uint64_t digit = number<uint16_t>();
            if (15 * i >= 64 || (digit << (15 * i)) >> (15 * i) != digit)
                throw TypeError("an integer of more than 64 bits");
            size |= digit << (15 * i);
        }
        Value value;
        const bool negative = digits < 0;
        if (negative && size > uint64_t(1) << 63) throw TypeError("an integer of more than 64 bits");
        value.content_ = Value::Integer{negative, negative ? 0 - size : size};
        return value;
    }

    std::string text() {
        const auto size = size_t(number<uint32_t>());
        return {take(size), size};
    }

    Value::List list() {
        Value::List all;
        const auto size = size_t(number<uint32_t>());
        all.reserve(std::min(size, size_t(end_ - at_)));
        for (size_t i = 0; i < size; ++i) all.push_back(read());
        return all;
    }

    Value::Dict dict() {
        Value::Dict all;
        while (at_ == end_ || *at_ != '0') {
            auto key = read().as<std::string>();
            all.emplace_back(std::move(key), read());
        }
        take(1);
        return all;
    }

    const char *at_, *end_;
};

class MarshalWriter {
public:
    void write(const Value &value) {
        std::visit([this](const auto &x) { put(x); }, value.content_);
    }
    std::string bytes;

private:
    template <class T>
    void number(T x) {
        char memory[sizeof(T)];
        std::memcpy(memory, &x, sizeof(T));
        bytes.append(memory, sizeof(T));
    }
    void sized(char type, const std::string &content) {
        bytes += type;
        number(uint32_t(content.size()));
        bytes += content;
    }

    void put(std::monostate) { bytes += 'N'; }
    void put(bool x) { bytes += x ? 'T' : 'F'; }
    void put(const Value::Integer &x) {
        uint64_t size = x.negative ? 0 - x.bits : x.bits;
        std::array<uint16_t, 5> digits{};
        int32_t n = 0;
        for (; size; size >>= 15) digits[size_t(n++)] = uint16_t(size & 0x7fff);
        bytes += 'l';
        number(x.negative ? -n : n);
        for (int32_t i = 0; i < n; ++i) number(digits[size_t(i)]);
    }
    void put(double x) {
        bytes += 'g';
        number(x);
    }
    void put(const std::string &x) { sized('u', x); }
    void put(const Bytes &x) { sized('s', x.content); }
    void put(const Value::List &x) {
        bytes += '[';
        number(uint32_t(x.size()));
        for (const Value &one : x) write(one);
    }
    void put(const Value::Dict &x) {
        bytes += '{';
        for (const auto &[name, value] : x) put(name), write(value);
        bytes += '0';
    }
};

std::string Value::to_bytes() const {
    MarshalWriter writer;
    writer.write(*this);
    return writer.bytes;
}

Value Value::from_bytes(const char *bytes, size_t size) { return MarshalReader(bytes, size).read(); }

void Value::refuse(const char *expected) const {
    constexpr const char *names[] = {"None",   "a boolean", "an integer", "a number",
                                     "a text", "bytes",     "a list",     "a dict"};
    throw TypeError(std::string("expected ") + expected + ", got " + names[content_.index()]);
}

}  // namespace tr
