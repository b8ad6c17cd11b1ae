// What the sketches of examples/devices use of Arduino, on the host: a clock that the fake sensor moves, and a serial port
// that is the standard output.
#pragma once

#include <stdint.h>
#include <stdio.h>
#include <string.h>

#define PROGMEM
#define pgm_read_byte(place) (*(const uint8_t *)(place))

extern uint64_t fake_clock_us;

inline unsigned long micros() { return (uint32_t)fake_clock_us; }
inline void delay(unsigned long ms) { fake_clock_us += 1000ull * ms; }

struct FakeSerial {
  void begin(unsigned long) {}
  void print(const char *text) { fputs(text, stdout); }
  size_t write(const uint8_t *data, size_t count) { return fwrite(data, 1, count, stdout); }
};
extern FakeSerial Serial;
