/* Types of C++ functions, deduced: what J2A_FUNCTION, J2A_BUFFER and J2A_SIF of a list (see j2a_lists.h) are made of.
 * In: a plain function and a text that names its parameters. Out: a function of kind call that takes the parameters
 * out of the request and leaves the results in the reply, and the line of the interface, made by the compiler.
 * Rules: C++11 without its library, which an AVR does not have; no RAM but the parameters on the stack.
 *
 * A text is what stands before its first colon, and documentation behind it:
 *   "channel -> mV !slow(5): Measures a channel."
 * First the names of the parameters in order, each with its unit in parentheses where it has one: "speed(m/s)". Then
 * "->" and the unit of what the function returns, then flags. Without a colon all of it is documentation. */
#ifndef J2A_DEDUCED_H
#define J2A_DEDUCED_H

#include "j2a_table.h"
#include "j2a_typed.h"

#ifdef __cplusplus

namespace j2a {

/* ------------------------------------------------------------------------- values ------ */

/* Integers by size and sign. */
template <unsigned size, bool is_signed> struct integer;
#define J2A_INTEGER_(size, is_signed, name) \
    template <> struct integer<size, is_signed> { \
        static constexpr const char *element() { \
            return #name; \
        } \
        template <class T> static T get(const uint8_t *bytes) { \
            return static_cast<T>(j2a_get_##name(bytes)); \
        } \
        template <class T> static void put(uint8_t *bytes, T value) { \
            j2a_put_##name(bytes, static_cast<decltype(j2a_get_##name(bytes))>(value)); \
        } \
    };
J2A_INTEGER_(1, false, u8)
J2A_INTEGER_(2, false, u16)
J2A_INTEGER_(4, false, u32)
J2A_INTEGER_(8, false, u64)
J2A_INTEGER_(1, true, i8)
J2A_INTEGER_(2, true, i16)
J2A_INTEGER_(4, true, i32)
J2A_INTEGER_(8, true, i64)

template <class T> struct no_type {
    static_assert(sizeof(T) == 0, "J2A cannot send this type; parameters: bool, integers, float, enum, const T (&x)[3], const char *, "
                                  "String; results: the same, or T &x and T (&x)[3]");
};
template <class T, bool is_enum = __is_enum(T)> struct scalar : no_type<T> {};
template <class T> struct scalar<T, true> : scalar<__underlying_type(T)> {};
#define J2A_BY_SIZE_(type) \
    template <> struct scalar<type, false> : integer<sizeof(type), (static_cast<type>(-1) < static_cast<type>(1))> {};
J2A_BY_SIZE_(char)
J2A_BY_SIZE_(signed char)
J2A_BY_SIZE_(unsigned char)
J2A_BY_SIZE_(short)
J2A_BY_SIZE_(unsigned short)
J2A_BY_SIZE_(int)
J2A_BY_SIZE_(unsigned int)
J2A_BY_SIZE_(long)
J2A_BY_SIZE_(unsigned long)
J2A_BY_SIZE_(long long)
J2A_BY_SIZE_(unsigned long long)
#define J2A_BY_NAME_(type, name) \
    template <> struct scalar<type, false> { \
        static constexpr const char *element() { \
            return #name; \
        } \
        template <class T> static T get(const uint8_t *bytes) { \
            return static_cast<T>(j2a_get_##name(bytes)); \
        } \
        template <class T> static void put(uint8_t *bytes, T value) { \
            j2a_put_##name(bytes, static_cast<type>(value)); \
        } \
    };
J2A_BY_NAME_(bool, bool)
J2A_BY_NAME_(float, f32)
#if DBL_MANT_DIG == 53
J2A_BY_NAME_(double, f64)
#else /* as on an AVR */
J2A_BY_NAME_(double, f32)
#endif

/* ------------------------------------------------------------------------- parameters ------ */

/* How many bytes a text has, 256 for all that no payload holds. */
inline uint16_t text_size(const char *text) {
    uint16_t size = 0;
    while (text != nullptr && size <= J2A_MAX_PAYLOAD && text[size] != '\0')
        size++;
    return size;
}

/* What each parameter tells of itself.
 * in, out: bytes that it takes of the request, and that it leaves in the reply.
 * count: elements of an array, 0 of what is none. */
template <class T, uint8_t in_bytes, uint8_t out_bytes, uint16_t elements = 0> struct of_type {
    static_assert(sizeof(T) * (elements == 0 ? 1u : elements) <= J2A_ROOM, "J2A: an array is longer than a payload");
    static constexpr uint8_t in = in_bytes;
    static constexpr uint8_t out = out_bytes;
    static constexpr bool is_text = false;
    static constexpr bool is_result = out_bytes != 0;
    static constexpr uint16_t count = elements;
    static constexpr const char *element() {
        return scalar<T>::element();
    }
    /* Did it find the memory that it needs? */
    static constexpr bool is_whole() {
        return true;
    }
};

/* One by value, or by reference to what it does not change. */
template <class T> struct parameter : of_type<T, sizeof(T), 0> {
    T value;
    explicit parameter(uint8_t *bytes, uint8_t, bool) : value(scalar<T>::template get<T>(bytes)) {
    }
    T pass() {
        return value;
    }
    void leave(uint8_t *) const {
    }
    static void send(uint8_t *bytes, T value) {
        scalar<T>::put(bytes, value);
    }
};
template <class T> struct parameter<const T &> : parameter<T> {
    using parameter<T>::parameter;
};
template <class T, uint16_t n> struct parameter<const T (&)[n]> : of_type<T, sizeof(T) * n, 0, n> {
    T value[n];
    explicit parameter(uint8_t *bytes, uint8_t, bool) {
        for (uint8_t i = 0; i < n; i++, bytes += sizeof(T))
            value[i] = scalar<T>::template get<T>(bytes);
    }
    const T (&pass())[n] {
        return value;
    }
    void leave(uint8_t *) const {
    }
    static void send(uint8_t *bytes, const T (&value)[n]) {
        for (uint8_t i = 0; i < n; i++, bytes += sizeof(T))
            scalar<T>::put(bytes, value[i]);
    }
};

/* One by reference, in which the function leaves a result. */
template <class T> struct parameter<T &> : of_type<T, 0, sizeof(T)> {
    T value;
    explicit parameter(uint8_t *, uint8_t, bool) : value() {
    }
    T &pass() {
        return value;
    }
    void leave(uint8_t *bytes) const {
        scalar<T>::put(bytes, value);
    }
};
template <class T, uint16_t n> struct parameter<T (&)[n]> : of_type<T, 0, sizeof(T) * n, n> {
    T value[n];
    explicit parameter(uint8_t *, uint8_t, bool) : value() {
    }
    T (&pass())[n] {
        return value;
    }
    void leave(uint8_t *bytes) const {
        for (uint8_t i = 0; i < n; i++, bytes += sizeof(T))
            scalar<T>::put(bytes, value[i]);
    }
};

/* A text, which takes all that is left. The NUL that ends it in C goes where the other parameters were, so that the
 * text moves by a byte; without others it goes behind the text, which is therefore shorter than a payload. */
struct text : of_type<char, 0, 0> {
    static constexpr bool is_text = true;
    static constexpr const char *element() {
        return "text";
    }
    char *value;
    explicit text(uint8_t *bytes, uint8_t length, bool has_others) : value(reinterpret_cast<char *>(bytes)) {
        if (has_others) {
            value--;
            for (uint8_t i = 0; i < length; i++)
                value[i] = value[i + 1];
        }
        value[length] = '\0';
    }
    const char *pass() {
        return value;
    }
    void leave(uint8_t *) const {
    }
};
template <> struct parameter<const char *> : text {
    using text::text;
};

/* All parameters of a function. */
template <class... P> struct parameters;
template <> struct parameters<> {
    static constexpr uint16_t in = 0, out = 0;
    static constexpr uint8_t inputs = 0;
    static constexpr bool has_text = false, is_text_last = true;
    explicit parameters(uint8_t *, uint8_t, bool) {
    }
    static constexpr bool is_whole() {
        return true;
    }
    template <class R, class F, class... A> R call(F function, A &&...arguments) {
        return function(static_cast<A &&>(arguments)...);
    }
    void leave(uint8_t *) const {
    }
};
template <class P, class... Rest> struct parameters<P, Rest...> {
    typedef parameters<Rest...> tail_t;
    static constexpr uint16_t in = parameter<P>::in + tail_t::in;
    static constexpr uint16_t out = parameter<P>::out + tail_t::out;
    static constexpr uint8_t inputs = (parameter<P>::is_result ? 0 : 1) + tail_t::inputs;
    static constexpr bool has_text = parameter<P>::is_text || tail_t::has_text;
    static constexpr bool is_text_last = tail_t::is_text_last && !(parameter<P>::is_text && tail_t::inputs != 0);
    parameter<P> head;
    tail_t tail;
    explicit parameters(uint8_t *bytes, uint8_t length, bool has_others)
        : head(bytes, length, has_others),
          tail(bytes + parameter<P>::in, static_cast<uint8_t>(length - parameter<P>::in), has_others) {
    }
    bool is_whole() const {
        return head.is_whole() && tail.is_whole();
    }
    template <class R, class F, class... A> R call(F function, A &&...arguments) {
        return tail.template call<R>(function, static_cast<A &&>(arguments)..., head.pass());
    }
    void leave(uint8_t *bytes) const {
        head.leave(bytes);
        tail.leave(bytes + parameter<P>::out);
    }
};

/* ------------------------------------------------------------------------- functions ------ */

/* What a function returns: the name of the type, and how the reply is made of it. */
template <class R> struct returned {
    static constexpr bool is_void = false;
    static constexpr const char *element() {
        return scalar<R>::element();
    }
    template <class Values, class F> static uint8_t end(F function, Values &values, uint8_t *length, uint8_t **payload) {
        const R result = values.template call<R>(function);
        scalar<R>::put(*payload, result);
        return j2a_end(length, sizeof(R));
    }
};
template <> struct returned<void> {
    static constexpr bool is_void = true;
    static constexpr const char *element() {
        return "";
    }
    template <class Values, class F> static uint8_t end(F function, Values &values, uint8_t *length, uint8_t **payload) {
        values.template call<void>(function);
        values.leave(*payload);
        return j2a_end(length, static_cast<uint8_t>(Values::out));
    }
};
template <> struct returned<const char *> {
    static constexpr bool is_void = false;
    static constexpr const char *element() {
        return "text";
    }
    /* The reply carries the characters where they are, as long as they are in memory that lasts. */
    template <class Values, class F> static uint8_t end(F function, Values &values, uint8_t *length, uint8_t **payload) {
        const char *const result = values.template call<const char *>(function);
        const uint16_t size = text_size(result);
        if (size > J2A_MAX_PAYLOAD)
            j2a_fail(J2A_RET_FAILED);
        else if (size != 0)
            *payload = reinterpret_cast<uint8_t *>(const_cast<char *>(result));
        return j2a_end(length, static_cast<uint8_t>(size));
    }
};

template <class F> struct function;
template <class R, class... P> struct function<R (*)(P...)> {
    typedef parameters<P...> values_t;
    static_assert(sizeof...(P) <= 16, "J2A_FUNCTION: a function has at most 16 parameters");
    static_assert(returned<R>::is_void || values_t::out == 0,
                  "J2A_FUNCTION: a function returns its result, or leaves results by reference, not both");
    static_assert(values_t::is_text_last, "J2A_FUNCTION: a text is the last parameter, because it takes all that is left");
    static_assert(values_t::in <= J2A_ROOM && values_t::out <= J2A_ROOM, "J2A_FUNCTION: the payload is longer than J2A_ROOM");
    template <R (*target)(P...)> static uint8_t call(uint8_t *const length, uint8_t **const payload) {
        constexpr bool has_others = values_t::in != 0;
        if (!(values_t::has_text ? j2a_begin_open(length, values_t::in, 1, has_others ? J2A_ROOM : J2A_ROOM - 1)
                                 : j2a_begin(length, values_t::in)))
            return J2A_RET_FAILED;
        values_t values(*payload, *length, has_others);
        if (!values.is_whole()) {
            *length = 0;
            return J2A_RET_FAILED;
        }
        return returned<R>::end(target, values, length, payload);
    }
};
#ifdef __cpp_noexcept_function_type /* since C++17 it is a part of the type */
template <class R, class... P> struct function<R (*)(P...) noexcept> : function<R (*)(P...)> {};
#endif

/* ------------------------------------------------------------------------- texts ------ */

constexpr const char *colon_of(const char *at) {
    return *at == '\0' || *at == ':' ? at : colon_of(at + 1);
}
constexpr const char *skipped(const char *at) {
    return *at == ' ' ? skipped(at + 1) : at;
}
constexpr const char *word_end(const char *at) {
    return *at == '\0' || *at == ' ' || *at == ':' ? at : word_end(at + 1);
}
constexpr const char *next_word(const char *at) {
    return skipped(word_end(at));
}
constexpr bool is_last(const char *at) {
    return *at == '\0' || *at == ':';
}
constexpr bool is_arrow(const char *at) {
    return at[0] == '-' && at[1] == '>';
}
constexpr const char *behind_arrow(const char *at) {
    return is_last(next_word(at)) ? next_word(at) : next_word(next_word(at));
}
/* The name number k from a word on: of a parameter, or the end. */
constexpr const char *name_at(const char *at, unsigned k) {
    return is_last(at)      ? at
           : *at == '!'     ? name_at(next_word(at), k)
           : is_arrow(at)   ? name_at(behind_arrow(at), k)
           : k == 0         ? at
                            : name_at(next_word(at), k - 1);
}
constexpr unsigned names_from(const char *at) {
    return is_last(name_at(at, 0)) ? 0 : 1 + names_from(next_word(name_at(at, 0)));
}
constexpr const char *flag_at(const char *at, unsigned k) {
    return is_last(at) ? at : *at != '!' ? flag_at(next_word(at), k) : k == 0 ? at : flag_at(next_word(at), k - 1);
}
constexpr const char *unit_of_result(const char *at) {
    return is_last(at) ? at : is_arrow(at) ? next_word(at) : unit_of_result(next_word(at));
}
constexpr const char *name_end(const char *at) {
    return is_last(at) || *at == ' ' || *at == '(' ? at : name_end(at + 1);
}
constexpr const char *unit_begin(const char *name) {
    return *name_end(name) == '(' ? name_end(name) + 1 : name_end(name);
}
constexpr const char *unit_end(const char *at) {
    return is_last(at) || *at == ' ' || *at == ')' ? at : unit_end(at + 1);
}
constexpr const char *words_of(const char *text) {
    return *colon_of(text) == ':' ? skipped(text) : colon_of(text);
}
constexpr const char *doc_of(const char *text) {
    return skipped(*colon_of(text) == ':' ? colon_of(text) + 1 : text);
}
constexpr unsigned long size_of(const char *at) {
    return *at == '\0' ? 0 : 1 + size_of(at + 1);
}

/* What the compiler checks. */
constexpr bool is_letter(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
}
constexpr bool is_digit(char c) {
    return c >= '0' && c <= '9';
}
constexpr bool are_name(const char *at, const char *end) {
    return at == end || ((is_letter(*at) || is_digit(*at)) && are_name(at + 1, end));
}
constexpr bool has_char(const char *set, char c) {
    return *set != '\0' && (*set == c || has_char(set + 1, c));
}
constexpr bool are_unit(const char *at, const char *end) {
    return at == end || ((is_letter(*at) || is_digit(*at) || has_char("%'*./^_+-[]{}", *at)) && are_unit(at + 1, end));
}
constexpr bool is_unit(const char *at, const char *end) {
    return end > at && end - at <= 32 && are_unit(at, end);
}
constexpr bool is_field(const char *at) {
    return is_letter(*at) && name_end(at) - at <= 32 && are_name(at, name_end(at)) &&
           (*name_end(at) != '(' || (is_unit(unit_begin(at), unit_end(unit_begin(at))) &&
                                     unit_end(unit_begin(at)) + 1 == word_end(at)));
}
constexpr bool are_fields(const char *at) {
    return is_last(name_at(at, 0)) || (is_field(name_at(at, 0)) && are_fields(next_word(name_at(at, 0))));
}
constexpr bool are_same(const char *a, const char *b) {
    return a == name_end(a) ? b == name_end(b) : b != name_end(b) && *a == *b && are_same(a + 1, b + 1);
}
constexpr bool is_word(const char *at, const char *word) {
    return *word == '\0' || (*at == *word && is_word(at + 1, word + 1));
}
constexpr bool are_digits(const char *at, const char *end) {
    return at == end || (is_digit(*at) && are_digits(at + 1, end));
}
constexpr unsigned long number_at(const char *at, unsigned long before) {
    return is_digit(*at) ? number_at(at + 1, before * 10 + static_cast<unsigned long>(*at - '0')) : before;
}
constexpr bool is_slow(const char *at) {
    return is_word(at, "!slow(") && word_end(at) - at > 7 && word_end(at) - at <= 12 && word_end(at)[-1] == ')' &&
           at[6] != '0' && are_digits(at + 6, word_end(at) - 1) && number_at(at + 6, 0) <= 65535;
}
constexpr bool is_flag(const char *at) {
    return (is_word(at, "!idempotent") && word_end(at) - at == 11) || is_slow(at);
}
constexpr bool are_flags(const char *at) {
    return is_last(flag_at(at, 2)) && (is_last(flag_at(at, 0)) || is_flag(flag_at(at, 0))) &&
           (is_last(flag_at(at, 1)) || is_flag(flag_at(at, 1)));
}
constexpr bool is_unit_of_result(const char *at, bool has_result) {
    return is_last(at)     ? true
           : !is_arrow(at) ? is_unit_of_result(next_word(at), has_result)
                           : has_result && word_end(at) - at == 2 && is_unit(next_word(at), word_end(next_word(at))) &&
                                 is_last(unit_of_result(next_word(at)));
}
constexpr bool are_printable(const char *at) {
    return *at == '\0' || (static_cast<unsigned char>(*at) >= ' ' && *at != 0x7F && are_printable(at + 1));
}

/* ------------------------------------------------------------------------- descriptions ------ */

constexpr unsigned digits_of(unsigned long value) {
    return value < 10 ? 1 : 1 + digits_of(value / 10);
}
constexpr char digit_of(unsigned long value, unsigned from_right) {
    return from_right == 0 ? static_cast<char>('0' + value % 10) : digit_of(value / 10, from_right - 1);
}

/* A part of a description: characters, or a number. */
struct part {
    const char *characters;
    unsigned long length;
    bool is_number;
    unsigned long value;
    constexpr char at(unsigned long i) const {
        return is_number ? digit_of(value, static_cast<unsigned>(length - 1 - i)) : characters[i];
    }
};
constexpr part no_part() {
    return {"", 0, false, 0};
}
constexpr part literal(const char *characters) {
    return {characters, size_of(characters), false, 0};
}
constexpr part part_of(const char *begin, const char *end) {
    return {begin, static_cast<unsigned long>(end - begin), false, 0};
}
constexpr part number(unsigned long value) {
    return {"", digits_of(value), true, value};
}

/* A line of the interface, of up to n parameters. lead: what stands before the name. mid, close: around the
 * fields. */
template <unsigned n> struct line {
    const char *lead, *name, *mid;
    long opcode; /* behind mid; below 0: none */
    const char *open, *close;
    const char *text; /* the user's */
    const char *result;
    unsigned long count; /* elements of the result, where it is a block of memory */
    const char *elements[n + 1];
    unsigned long counts[n + 1];
    bool is_result[n + 1];

    static constexpr unsigned FIELD = 9;
    static constexpr unsigned INPUTS = 6;
    static constexpr unsigned RESULT = INPUTS + FIELD * n;
    static constexpr unsigned OUTPUTS = RESULT + 8;
    static constexpr unsigned FLAGS = OUTPUTS + FIELD * n;
    static constexpr unsigned PARTS = FLAGS + 7;

    constexpr unsigned results_before(unsigned k) const {
        return k == 0 ? 0 : (is_result[k - 1] ? 1 : 0) + results_before(k - 1);
    }
    constexpr bool has_results() const {
        return results_before(n) != 0;
    }
    constexpr bool is_first(unsigned k, bool of_results) const {
        return (of_results ? results_before(k) : k - results_before(k)) == 0;
    }
    constexpr const char *words() const {
        return words_of(text);
    }
    /* No two parameters have the same name, and no two results. */
    constexpr bool differs(unsigned k, unsigned from) const {
        return from >= n || ((is_result[k] != is_result[from] || !are_same(name_at(words(), k), name_at(words(), from))) &&
                             differs(k, from + 1));
    }
    constexpr bool differ(unsigned k) const {
        return k >= n || (differs(k, k + 1) && differ(k + 1));
    }
    /* Separator, name, space, element, bracket, count, bracket, space, unit. */
    constexpr part of_field(unsigned k, unsigned i, bool of_results) const {
        return is_result[k] != of_results          ? no_part()
               : i == 0                            ? literal(is_first(k, of_results) ? "" : ", ")
               : i == 1                            ? part_of(name_at(words(), k), name_end(name_at(words(), k)))
               : i == 2                            ? literal(" ")
               : i == 3                            ? literal(elements[k])
               : i < 7 && counts[k] == 0           ? no_part()
               : i == 4                            ? literal("[")
               : i == 5                            ? number(counts[k])
               : i == 6                            ? literal("]")
               : *name_end(name_at(words(), k)) != '(' ? no_part()
               : i == 7                            ? literal(" ")
                                                   : part_of(unit_begin(name_at(words(), k)),
                                                             unit_end(unit_begin(name_at(words(), k))));
    }
    /* Space or parenthesis, element, bracket, count, bracket, space, unit. */
    constexpr part of_result(unsigned i) const {
        return i == 0                              ? literal(*result != '\0' ? " " : has_results() ? " (" : "")
               : *result == '\0'                   ? no_part()
               : i == 1                            ? literal(result)
               : i < 5 && count == 0               ? no_part()
               : i == 2                            ? literal("[")
               : i == 3                            ? number(count)
               : i == 4                            ? literal("]")
               : is_last(unit_of_result(words()))  ? no_part()
               : i == 5                            ? literal(" ")
               : i == 6                            ? part_of(unit_of_result(words()), word_end(unit_of_result(words())))
                                                   : no_part();
    }
    constexpr part of_end(unsigned i) const {
        return i == 0   ? literal(has_results() ? ")" : "")
               : i == 5 ? literal(*doc_of(text) == '\0' ? "" : " # ")
               : i == 6 ? literal(doc_of(text))
               : is_last(flag_at(words(), (i - 1) / 2)) ? no_part()
               : i % 2 == 1 ? literal(" ")
                            : part_of(flag_at(words(), (i - 1) / 2), word_end(flag_at(words(), (i - 1) / 2)));
    }
    constexpr part at(unsigned i) const {
        return i == 0        ? literal(lead)
               : i == 1      ? literal(name)
               : i == 2      ? literal(mid)
               : i == 3      ? (opcode < 0 ? no_part() : number(static_cast<unsigned long>(opcode)))
               : i == 4      ? literal(opcode < 0 ? "" : " ")
               : i == 5      ? literal(open)
               : i < RESULT  ? of_field((i - INPUTS) / FIELD, (i - INPUTS) % FIELD, false)
               : i == RESULT ? literal(close)
               : i < OUTPUTS ? of_result(i - RESULT - 1)
               : i < FLAGS   ? of_field((i - OUTPUTS) / FIELD, (i - OUTPUTS) % FIELD, true)
                             : of_end(i - FLAGS);
    }
};

/* The parts of a line, worked out once, and what they are put together to. */
template <unsigned n> struct parts {
    part of[n];
    constexpr unsigned long length(unsigned i) const {
        return i == n ? 0 : of[i].length + length(i + 1);
    }
    /* Character i of the first k parts, which have so many. From the last one on: that is the documentation, the longest. */
    constexpr char at(unsigned long i, unsigned k, unsigned long count) const {
        return i < count - of[k - 1].length ? at(i, k - 1, count - of[k - 1].length)
                                            : of[k - 1].at(i - (count - of[k - 1].length));
    }
};
template <unsigned... i> struct indices {};
template <class A, class B> struct joined;
template <unsigned... a, unsigned... b> struct joined<indices<a...>, indices<b...>> {
    typedef indices<a..., (sizeof...(a) + b)...> type;
};
template <unsigned n> struct up_to {
    typedef typename joined<typename up_to<n / 2>::type, typename up_to<n - n / 2>::type>::type type;
};
template <> struct up_to<0> {
    typedef indices<> type;
};
template <> struct up_to<1> {
    typedef indices<0> type;
};
template <unsigned long n> struct characters {
    char of[n];
};
template <unsigned n, unsigned... i> constexpr parts<sizeof...(i)> parts_of(const line<n> &from, indices<i...>) {
    return {{from.at(i)...}};
}
template <unsigned n> constexpr parts<line<n>::PARTS> parts_of(const line<n> &from) {
    return parts_of(from, typename up_to<line<n>::PARTS>::type());
}
template <unsigned n, unsigned... i> constexpr characters<sizeof...(i)> written(const parts<n> &from, char end,
                                                                                indices<i...>) {
    return {{(i == sizeof...(i) - 1 ? end : from.at(i, n, sizeof...(i) - 1))...}};
}
template <unsigned long size, unsigned n> constexpr characters<size> written(const parts<n> &from, char end) {
    return written(from, end, typename up_to<size>::type());
}

template <class F> struct describe {
    static_assert(sizeof(F) == 0, "J2A_FUNCTION: this is no plain function; for an array use J2A_BUFFER, for a j2a::sif J2A_SIF");
};
template <class R, class... P> struct describe<R (*)(P...)> {
    static constexpr unsigned names = sizeof...(P);
    static constexpr bool has_result = !returned<R>::is_void;
    static constexpr line<sizeof...(P)> with(const char *name, const char *text) {
        return {"", name, "", -1, "(", ")", text, returned<R>::element(), 0, {parameter<P>::element()..., ""},
                {parameter<P>::is_text && parameters<P...>::in == 0 ? J2A_ROOM - 1u : parameter<P>::count..., 0},
                {parameter<P>::is_result..., false}};
    }
};
#ifdef __cpp_noexcept_function_type
template <class R, class... P> struct describe<R (*)(P...) noexcept> : describe<R (*)(P...)> {};
#endif

/* ------------------------------------------------------------------------- memory ------ */

template <class T> struct memory {
    static_assert(sizeof(T) == 0, "J2A_BUFFER: this is no array");
};
template <class T, unsigned long n> struct memory<T[n]> {
    static_assert(n <= 65535, "J2A_BUFFER: an array has at most 65535 elements");
    static_assert(*scalar<T>::element() != 'b', "J2A_BUFFER: no bool, because a host may write any byte; take uint8_t");
    static constexpr unsigned names = 0;
    static constexpr bool has_result = true;
    static constexpr line<0> with(const char *name, const char *text) {
        return {"", name, " many", -1, "", "", text,
                sizeof(T) == 1 && *scalar<T>::element() == 'u' ? "bytes" : scalar<T>::element(), n,
                {""}, {0}, {false}};
    }
    /* By its address, because avr-gcc 5.4 takes no reference to a static array. */
    template <T (*of)[n]> static uint8_t many(bool *is_last, bool is_write, uint32_t *const offset, uint8_t *const length,
                                              uint8_t **const data) {
        return j2a_buffer(reinterpret_cast<uint8_t *>(*of), sizeof *of, sizeof(T), is_last, is_write, *offset, length,
                          *data);
    }
};

/* ------------------------------------------------------------------------- SIFs ------ */

#if J2A_WITH_SIF
template <class... P> struct fields {
    static void put(uint8_t *) {
    }
};
template <class P, class... Rest> struct fields<P, Rest...> {
    static void put(uint8_t *bytes, P first, Rest... rest) {
        parameter<P>::send(bytes, first);
        fields<Rest...>::put(bytes + parameter<P>::in, rest...);
    }
};

/* A SIF by its opcode and the types of its fields: j2a::sif<0x20, uint32_t, uint16_t> report; report(now, value); */
template <unsigned long opcode, class... P> struct sif {
    static constexpr uint8_t number = static_cast<uint8_t>(opcode);
    static constexpr uint16_t size = parameters<P...>::in;
    /* Checked here, because the Arduino core's -fpermissive lets a number be cut off. */
    static_assert(opcode <= 255, "j2a::sif: an opcode is 0 to 255");
    static_assert(size <= J2A_MAX_PAYLOAD, "j2a::sif: the payload is longer than 255 bytes");
    static_assert(!parameters<P...>::has_text && parameters<P...>::out == 0, "j2a::sif: fields are numbers and arrays");
    static_assert(!(J2A_WITH_BOOT && opcode == J2A_BOOT), "j2a::sif: the opcode is that of the boot SIF");
    void operator()(P... values) const {
        uint8_t payload[size + 1]; /* C++ has no empty arrays */
        fields<P...>::put(payload, values...);
        j2a_send_sif(number, static_cast<uint8_t>(size), payload);
    }
};
template <class S> struct describe_sif {
    static_assert(sizeof(S) == 0, "J2A_SIF: this is no j2a::sif<opcode, types...>");
};
template <unsigned long opcode, class... P> struct describe_sif<sif<opcode, P...>> {
    static constexpr unsigned names = sizeof...(P);
    static constexpr bool has_result = false;
    static constexpr line<sizeof...(P)> with(const char *name, const char *text) {
        return {"sif ", name, " ", static_cast<long>(opcode), "(", ")", text, "", 0, {parameter<P>::element()..., ""},
                {parameter<P>::count..., 0}, {parameter<P>::is_result..., false}};
    }
};
template <class S> struct describe_sif<const S> : describe_sif<S> {};
#endif

/* Of properties: whether key number k comes again behind it. */
constexpr bool is_key(const char *a, const char *b) {
    return *a == *b && (*a == '\0' || is_key(a + 1, b + 1));
}
constexpr bool is_key_again(const char *const *keys, unsigned k, unsigned from) {
    return *keys[from] != '\0' && (is_key(keys[k], keys[from]) || is_key_again(keys, k, from + 1));
}
constexpr bool is_a_key_twice(const char *const *keys, unsigned k) {
    return *keys[k] != '\0' && (is_key_again(keys, k, k + 1) || is_a_key_twice(keys, k + 1));
}

} // namespace j2a

/* Checks a text against what it describes, which it keeps for the compiler as j2a_line_of_`target`. Its length has a limit,
 * because compilers nest no more than 512 calls. */
#define J2A_CHECK_TEXT_(described, target, text) \
    static constexpr char j2a_text_of_##target[] = text; \
    static_assert(sizeof j2a_text_of_##target <= 500, "J2A: " #target ": a text is shorter than 500 bytes"); \
    static constexpr auto j2a_line_of_##target = described::with(#target, j2a_text_of_##target); \
    static_assert(j2a::are_fields(j2a_line_of_##target.words()), \
                  "J2A: " #target ": a name is letters, digits and _, at most 32, and a unit may follow: speed(m/s)"); \
    static_assert(j2a::names_from(j2a_line_of_##target.words()) == described::names, \
                  "J2A: " #target ": as many names as parameters stand in front of the colon: \"a b: Adds.\""); \
    static_assert(j2a_line_of_##target.differ(0), "J2A: " #target ": two parameters have the same name"); \
    static_assert(j2a::are_flags(j2a_line_of_##target.words()), \
                  "J2A: " #target ": flags are !idempotent and !slow(1) to !slow(65535)"); \
    static_assert(j2a::is_unit_of_result(j2a_line_of_##target.words(), described::has_result), \
                  "J2A: " #target ": behind -> comes the unit of what the function returns"); \
    static_assert(j2a::are_printable(j2a_text_of_##target), "J2A: " #target ": a text is one line");

/* Writes such a line into flash as j2a_map_of_`target`. */
#define J2A_WRITE_LINE_(target) \
    static constexpr auto j2a_parts_of_##target = j2a::parts_of(j2a_line_of_##target); \
    static constexpr j2a::characters<j2a_parts_of_##target.length(0) + 1> J2A_FLASH j2a_map_of_##target = \
        j2a::written<j2a_parts_of_##target.length(0) + 1>(j2a_parts_of_##target, '\0');

/* The same with a line feed at its end, as a constant of the compiler. */
#define J2A_WRITE_DEFINITION_(target) \
    static constexpr auto j2a_parts_of_##target = j2a::parts_of(j2a_line_of_##target); \
    static constexpr auto j2a_map_of_##target = \
        j2a::written<j2a_parts_of_##target.length(0) + 1>(j2a_parts_of_##target, '\n');

#endif
#endif
