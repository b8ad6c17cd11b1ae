// A bus with one sensor on it.
#pragma once

#include "Arduino.h"

struct FakeWire {
  void begin() {}
  void setClock(unsigned long) {}
  void beginTransmission(uint8_t address);
  size_t write(uint8_t value);
  uint8_t endTransmission(bool stop = true);
  uint8_t requestFrom(uint8_t address, uint8_t count);
  int read();

 private:
  uint8_t address_, sent_[40], count_, reg_;
};
extern FakeWire Wire;
