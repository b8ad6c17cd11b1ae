// MPU-9250 at 200 Hz: 4 g, 500 deg/s, bandwidth 92 and 99 Hz. The MPU-9255 answers 0x73.
// Registers: InvenSense RM-MPU-9250A-00, revision 1.6; sensitivities: PS-MPU-9250A-01, revision 1.1.
#include <GnomonImu.h>

const uint8_t ADDRESS = 0x68;  // 0x69 where AD0 is high
const float FORCE = gnomon::G / 8192, RATE = gnomon::DEGREE / 65.5f;

void setup() {
  gnomon::begin("MPU-9250", ADDRESS, 0x75, 0x71);  // WHO_AM_I
  gnomon::writeRegister(ADDRESS, 0x6B, 0x80);  // PWR_MGMT_1: reset
  delay(100);
  gnomon::writeRegister(ADDRESS, 0x6B, 0x01);  // awake, clock of the gyroscope
  gnomon::writeRegister(ADDRESS, 0x1A, 0x02);  // CONFIG: filter of the gyroscope, 92 Hz
  gnomon::writeRegister(ADDRESS, 0x19, 4);     // SMPLRT_DIV: 1000 Hz / (1 + 4)
  gnomon::writeRegister(ADDRESS, 0x1B, 0x08);  // GYRO_CONFIG: 500 deg/s, 65.5 LSB/(deg/s)
  gnomon::writeRegister(ADDRESS, 0x1C, 0x08);  // ACCEL_CONFIG: 4 g, 8192 LSB/g
  gnomon::writeRegister(ADDRESS, 0x1D, 0x02);  // ACCEL_CONFIG_2: filter of 99 Hz
  gnomon::writeRegister(ADDRESS, 0x38, 0x01);  // INT_ENABLE: data ready
}

void loop() {
  if (!(gnomon::readRegister(ADDRESS, 0x3A) & 0x01)) return;  // INT_STATUS: data ready
  const unsigned long stamp_us = micros();
  gnomon::Sample sample;
  if (!gnomon::readSample(ADDRESS, 0x3B, 8, 6, &sample)) return;  // acceleration, temperature, rate
  gnomon::send(stamp_us, sample, FORCE, RATE, sample.temperature / 333.87f + 21);
}
