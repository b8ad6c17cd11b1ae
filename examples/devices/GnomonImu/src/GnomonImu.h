// What the sketches share: registers over I2C, and one line a sample,
//
//   $IMUSI,micros,ax,ay,az,gx,gy,gz,temperature*hh
//
// in microseconds (32 bits, they begin again after 71 minutes), m/s^2, rad/s and degrees Celsius; hh is the exclusive or
// of the characters between $ and *, in hexadecimal. Lines that begin with # are remarks.
#pragma once

#include <Arduino.h>
#include <Wire.h>

namespace gnomon {

const float G = 9.80665f;                   // m/s^2
const float DEGREE = 0.01745329252f;        // rad
const unsigned long BAUD = 500000;          // 225 lines a second need 22 000 characters a second

struct Sample {
  int16_t accel[3], gyro[3], temperature;   // counts
};

inline bool writeRegister(uint8_t address, uint8_t reg, uint8_t value) {
  Wire.beginTransmission(address);
  Wire.write(reg);
  Wire.write(value);
  return Wire.endTransmission() == 0;
}

inline bool readRegisters(uint8_t address, uint8_t reg, uint8_t *data, uint8_t count) {
  Wire.beginTransmission(address);
  Wire.write(reg);
  if (Wire.endTransmission(false) != 0 || Wire.requestFrom(address, count) != count) return false;
  for (uint8_t i = 0; i < count; i++) data[i] = Wire.read();
  return true;
}

inline uint8_t readRegister(uint8_t address, uint8_t reg) {
  uint8_t value = 0;
  readRegisters(address, reg, &value, 1);
  return value;
}

inline int16_t bigEndian(const uint8_t *data) { return (int16_t)((uint16_t)data[0] << 8 | data[1]); }
inline int16_t littleEndian(const uint8_t *data) { return (int16_t)((uint16_t)data[1] << 8 | data[0]); }

// Reads 14 bytes from `reg` on, most significant first: the acceleration, then rate and temperature at the places stated.
inline bool readSample(uint8_t address, uint8_t reg, uint8_t rateAt, uint8_t temperatureAt, Sample *sample) {
  uint8_t data[14];
  if (!readRegisters(address, reg, data, sizeof data)) return false;
  for (uint8_t i = 0; i < 3; i++) {
    sample->accel[i] = bigEndian(data + 2 * i);
    sample->gyro[i] = bigEndian(data + rateAt + 2 * i);
  }
  sample->temperature = bigEndian(data + temperatureAt);
  return true;
}

// Starts the serial port and the bus, and waits for the sensor that answers `id` in the register `reg`.
inline void begin(const char *name, uint8_t address, uint8_t reg, uint8_t id) {
  Serial.begin(BAUD);
  Wire.begin();
  Wire.setClock(400000);
  while (readRegister(address, reg) != id) {
    Serial.print("# no ");
    Serial.print(name);
    Serial.print("; is it wired, and is its address right?\n");
    delay(1000);
  }
}

class Line {
 public:
  Line() : length_(0) { text("$IMUSI"); }

  void integer(unsigned long value) {
    char digits[10];
    uint8_t count = 0;
    do digits[count++] = '0' + value % 10; while (value /= 10);
    while (count) put(digits[--count]);
  }

  void comma() { put(','); }

  // A number with so many decimals; snprintf has no %f on AVR.
  void number(float value, uint8_t decimals) {
    comma();
    float scale = 1;
    for (uint8_t i = 0; i < decimals; i++) scale *= 10;
    if (value < 0) put('-');
    unsigned long whole = (unsigned long)((value < 0 ? -value : value) * scale + 0.5f), unit = (unsigned long)scale;
    integer(whole / unit);
    put('.');
    for (unsigned long rest = whole % unit; unit > 1; rest %= unit) put('0' + rest / (unit /= 10));
  }

  void send() {
    uint8_t sum = 0;
    for (uint8_t i = 1; i < length_; i++) sum ^= text_[i];
    put('*');
    put("0123456789ABCDEF"[sum >> 4]);
    put("0123456789ABCDEF"[sum & 15]);
    put('\n');
    Serial.write((const uint8_t *)text_, length_);
  }

 private:
  void put(char character) {
    if (length_ < sizeof text_) text_[length_++] = character;
  }
  void text(const char *characters) {
    while (*characters) put(*characters++);
  }
  char text_[128];
  uint8_t length_;
};

// Sends a sample; one count is `force` m/s^2 and `rate` rad/s.
inline void send(unsigned long stamp_us, const Sample &sample, float force, float rate, float celsius) {
  Line line;
  line.comma();
  line.integer(stamp_us);
  for (uint8_t i = 0; i < 3; i++) line.number(sample.accel[i] * force, 4);
  for (uint8_t i = 0; i < 3; i++) line.number(sample.gyro[i] * rate, 5);
  line.number(celsius, 2);
  line.send();
}

}  // namespace gnomon
