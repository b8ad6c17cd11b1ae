// MPU-6050 at 200 Hz: 4 g, 500 deg/s, bandwidth 94 Hz.
// Registers: InvenSense RM-MPU-6000A-00, revision 4.2; sensitivities: PS-MPU-6000A-00, revision 3.4.
#include <GnomonImu.h>

const uint8_t ADDRESS = 0x68;  // 0x69 where AD0 is high
const float FORCE = gnomon::G / 8192, RATE = gnomon::DEGREE / 65.5f;

void setup() {
  gnomon::begin("MPU-6050", ADDRESS, 0x75, 0x68);  // WHO_AM_I
  gnomon::writeRegister(ADDRESS, 0x6B, 0x80);  // PWR_MGMT_1: reset
  delay(100);
  gnomon::writeRegister(ADDRESS, 0x6B, 0x01);  // awake, clock of the gyroscope
  gnomon::writeRegister(ADDRESS, 0x1A, 0x02);  // CONFIG: filter of 94 Hz (accelerometer) and 98 Hz (gyroscope)
  gnomon::writeRegister(ADDRESS, 0x19, 4);     // SMPLRT_DIV: 1000 Hz / (1 + 4)
  gnomon::writeRegister(ADDRESS, 0x1B, 0x08);  // GYRO_CONFIG: 500 deg/s, 65.5 LSB/(deg/s)
  gnomon::writeRegister(ADDRESS, 0x1C, 0x08);  // ACCEL_CONFIG: 4 g, 8192 LSB/g
  gnomon::writeRegister(ADDRESS, 0x38, 0x01);  // INT_ENABLE: data ready
}

void loop() {
  if (!(gnomon::readRegister(ADDRESS, 0x3A) & 0x01)) return;  // INT_STATUS: data ready
  const unsigned long stamp_us = micros();
  gnomon::Sample sample;
  if (!gnomon::readSample(ADDRESS, 0x3B, 8, 6, &sample)) return;  // acceleration, temperature, rate
  gnomon::send(stamp_us, sample, FORCE, RATE, sample.temperature / 340.0f + 36.53f);
}
