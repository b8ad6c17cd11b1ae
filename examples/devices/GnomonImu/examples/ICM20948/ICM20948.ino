// ICM-20948 at 225 Hz: 4 g, 500 deg/s, bandwidth 111 and 120 Hz.
// Registers and sensitivities: TDK InvenSense DS-000189, revision 1.3.
#include <GnomonImu.h>

const uint8_t ADDRESS = 0x69;  // 0x68 where AD0 is low
const float FORCE = gnomon::G / 8192, RATE = gnomon::DEGREE / 65.5f;

static void bank(uint8_t number) { gnomon::writeRegister(ADDRESS, 0x7F, number << 4); }  // REG_BANK_SEL

void setup() {
  gnomon::begin("ICM-20948", ADDRESS, 0x00, 0xEA);  // WHO_AM_I
  bank(0);
  gnomon::writeRegister(ADDRESS, 0x06, 0x80);  // PWR_MGMT_1: reset
  delay(100);
  gnomon::writeRegister(ADDRESS, 0x06, 0x01);  // awake, best clock
  delay(40);
  bank(2);
  gnomon::writeRegister(ADDRESS, 0x00, 4);     // GYRO_SMPLRT_DIV: 1125 Hz / (1 + 4)
  gnomon::writeRegister(ADDRESS, 0x01, 0x13);  // GYRO_CONFIG_1: 119.5 Hz, 500 deg/s, 65.5 LSB/(deg/s)
  gnomon::writeRegister(ADDRESS, 0x10, 0);     // ACCEL_SMPLRT_DIV_1
  gnomon::writeRegister(ADDRESS, 0x11, 4);     // ACCEL_SMPLRT_DIV_2: 1125 Hz / (1 + 4)
  gnomon::writeRegister(ADDRESS, 0x14, 0x13);  // ACCEL_CONFIG: 111.4 Hz, 4 g, 8192 LSB/g
  bank(0);
  gnomon::writeRegister(ADDRESS, 0x11, 0x01);  // INT_ENABLE_1: data ready
}

void loop() {
  if (!(gnomon::readRegister(ADDRESS, 0x1A) & 0x01)) return;  // INT_STATUS_1: data ready
  const unsigned long stamp_us = micros();
  gnomon::Sample sample;
  if (!gnomon::readSample(ADDRESS, 0x2D, 6, 12, &sample)) return;  // acceleration, rate, temperature
  gnomon::send(stamp_us, sample, FORCE, RATE, sample.temperature / 333.87f + 21);
}
