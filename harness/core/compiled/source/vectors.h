// Registers of WIDTH floats and the functions of them that networks and splines need.

#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#ifndef WIDTH
#define WIDTH 8
#endif

namespace {

typedef float Floats __attribute__((vector_size(WIDTH * 4)));
typedef int32_t Ints __attribute__((vector_size(WIDTH * 4)));

#define INLINE inline __attribute__((always_inline))

INLINE Floats load(const float *p) {
    Floats v;
    memcpy(&v, p, sizeof(v));
    return v;
}

INLINE void store(float *p, Floats v) { memcpy(p, &v, sizeof(v)); }

// Not 0 + x, which would cost an addition: it is not x where x is -0.
INLINE Floats all(float x) { return x - Floats{}; }

INLINE Floats magnitude(Floats v) { return (Floats)((Ints)v & 0x7fffffff); }

INLINE Floats square_root(Floats v) {
#if WIDTH == 16 && defined(__AVX512F__)
    return (Floats)_mm512_sqrt_ps((__m512)v);
#elif WIDTH == 8 && defined(__AVX__)
    return (Floats)_mm256_sqrt_ps((__m256)v);
#else
    for (int i = 0; i < WIDTH; i++) v[i] = std::sqrt(v[i]);
    return v;
#endif
}

// a b + c, rounded once: said, where a compiler that chooses would round rows differently.
INLINE Floats fused(Floats a, Floats b, Floats c) {
#if WIDTH == 16 && defined(__AVX512F__)
    return (Floats)_mm512_fmadd_ps((__m512)a, (__m512)b, (__m512)c);
#elif WIDTH == 8 && defined(__FMA__)
    return (Floats)_mm256_fmadd_ps((__m256)a, (__m256)b, (__m256)c);
#else
    for (int i = 0; i < WIDTH; i++) c[i] = __builtin_fmaf(a[i], b[i], c[i]);
    return c;
#endif
}

INLINE float fused(float a, float b, float c) { return __builtin_fmaf(a, b, c); }

// Nearest whole number of |v| < 2^22.
INLINE Floats nearest(Floats v) {
    const Floats magic = all(12582912.0f);  // 1.5 * 2^23
    return (v + magic) - magic;
}

INLINE Floats power_of_two(Ints n) { return (Floats)((n + 127) << 23); }

// 2^n and e^r - 1, of which e^v = 2^n e^r and |r| <= log(2) / 2.
INLINE Floats whole_and_rest(Floats v, Floats &rest) {
    Floats n = nearest(v * 1.44269504f);
    Floats r = v - n * 0.693145752f;  // 15 bits: exact products
    r = r - n * 1.42860677e-6f;
    Floats p = all(1.0f / 5040);
    p = p * r + 1.0f / 720;
    p = p * r + 1.0f / 120;
    p = p * r + 1.0f / 24;
    p = p * r + 1.0f / 6;
    p = p * r + 0.5f;
    rest = p * r * r + r;
    return n;
}

// e^v to 1 ulp or two; denormal results and infinity in two steps of the exponent.
INLINE Floats exponential(Floats v) {
    const Floats low = all(-104.0f), high = all(89.0f);
    // Beyond these bounds the result is 0 or infinite anyway; a nan stays one.
    Floats x = v < low ? low : v;
    x = x > high ? high : x;
    Floats rest, n = whole_and_rest(x, rest);
    Ints k = __builtin_convertvector(n, Ints);
    Ints half = k >> 1;
    return (rest + 1.0f) * power_of_two(half) * power_of_two(k - half);
}

// The same with 2^n as it is; |v| <= 87, so that it is a normal number.
INLINE Floats power_and_rest(Floats v, Floats &rest) {
    return power_of_two(__builtin_convertvector(whole_and_rest(v, rest), Ints));
}

// e^v to 1 ulp for v <= 0; what would be a denormal number is less than 1e-37.
INLINE Floats exponential_below_one(Floats v) {
    const Floats low = all(-87.0f);
    Floats rest, power = power_and_rest(low > v ? low : v, rest);
    return power + power * rest;
}

// Between bounds beyond which the functions below do not change any more; a nan stays one.
INLINE Floats between(Floats v, float bound) {
    Floats x = v < -bound ? all(-bound) : v;
    return x > bound ? all(bound) : x;
}

// 1 / (1 + e^-v).
INLINE Floats logistic(Floats v) {
    Floats rest, power = power_and_rest(between(-v, 87.0f), rest);
    return 1.0f / (1.0f + (power + power * rest));
}

// With all digits near zero too: e^2v - 1 over e^2v + 1.
INLINE Floats hyperbolic_tangent(Floats v) {
    Floats rest, power = power_and_rest(between(2.0f * v, 40.0f), rest);
    Floats less = power * rest + (power - 1.0f);
    return less / (less + 2.0f);
}

// v less k quarter turns.
INLINE Floats less_quarters(Floats v, Floats k) {
    v = v - k * 1.57079637f;
    v = v + k * 4.37113883e-8f;
    return v + k * 1.71512489e-15f;
}

// Sine and cosine of |v| <= 2^24: quarter turns subtracted, then Taylor's series.
INLINE void sine_and_cosine(Floats v, Floats &sine, Floats &cosine) {
    // Far out the number of quarters is rounded, and one may be left or too many.
    Floats many = __builtin_convertvector(__builtin_convertvector(v * 0.636619772f, Ints), Floats);
    Floats r = less_quarters(v, many);
    Floats few = nearest(r * 0.636619772f);
    r = less_quarters(r, few);
    Floats k = many + few;
    Ints turn = __builtin_convertvector(k, Ints);
    Floats q = r * r;
    Floats s = all(2.75573192e-6f);
    s = s * q - 1.98412698e-4f;
    s = s * q + 8.33333333e-3f;
    s = s * q - 1.66666667e-1f;
    s = s * q * r + r;
    Floats c = all(-2.75573192e-7f);
    c = c * q + 2.48015873e-5f;
    c = c * q - 1.38888889e-3f;
    c = c * q + 4.16666667e-2f;
    c = c * q * q - 0.5f * q + 1.0f;
    Ints odd = (turn & 1) != 0;
    Floats a = odd ? c : s, b = odd ? s : c;
    sine = (turn & 2) != 0 ? -a : a;
    cosine = ((turn + 1) & 2) != 0 ? -b : b;
}

// log(1 + e) for e in [0, 1]: the series of the inverse hyperbolic tangent at e / (2 + e) <= 1/3.
INLINE Floats log_of_one_and(Floats e) {
    Floats t = e / (2.0f + e), q = t * t;
    Floats p = all(1.0f / 15);
    p = p * q + 1.0f / 13;
    p = p * q + 1.0f / 11;
    p = p * q + 1.0f / 9;
    p = p * q + 1.0f / 7;
    p = p * q + 1.0f / 5;
    p = p * q + 1.0f / 3;
    p = p * q * t + t;
    return 2.0f * p;
}

}  // namespace
