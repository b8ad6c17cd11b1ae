// LSM6DSO at 208 Hz: 4 g, 500 deg/s.
// Registers and sensitivities: ST DS12140, revision 2.
#include <GnomonImu.h>

const uint8_t ADDRESS = 0x6A;  // 0x6B where SA0 is high
const float FORCE = 0.122e-3f * gnomon::G, RATE = 17.5e-3f * gnomon::DEGREE;

void setup() {
  gnomon::begin("LSM6DSO", ADDRESS, 0x0F, 0x6C);  // WHO_AM_I
  gnomon::writeRegister(ADDRESS, 0x12, 0x01);  // CTRL3_C: reset
  delay(10);
  gnomon::writeRegister(ADDRESS, 0x12, 0x44);  // CTRL3_C: both bytes of one sample, addresses count up
  gnomon::writeRegister(ADDRESS, 0x10, 0x58);  // CTRL1_XL: 208 Hz, 4 g, 0.122 mg/LSB
  gnomon::writeRegister(ADDRESS, 0x11, 0x54);  // CTRL2_G: 208 Hz, 500 deg/s, 17.5 mdeg/s/LSB
}

void loop() {
  if ((gnomon::readRegister(ADDRESS, 0x1E) & 0x03) != 0x03) return;  // STATUS_REG: both are ready
  const unsigned long stamp_us = micros();
  uint8_t data[14];
  if (!gnomon::readRegisters(ADDRESS, 0x20, data, sizeof data)) return;  // temperature, rate, acceleration
  gnomon::Sample sample;
  for (uint8_t i = 0; i < 3; i++) {
    sample.gyro[i] = gnomon::littleEndian(data + 2 + 2 * i);
    sample.accel[i] = gnomon::littleEndian(data + 8 + 2 * i);
  }
  sample.temperature = gnomon::littleEndian(data);
  gnomon::send(stamp_us, sample, FORCE, RATE, sample.temperature / 256.0f + 25);
}
