// BMI270 at 200 Hz: 4 g, 500 deg/s, normal filter.
// Registers and sensitivities: Bosch BST-BMI270-DS000, revision 1.
//
// The sensor needs Bosch's configuration after each start. Copy the array `bmi270_config_file` (8192 bytes, BSD licence)
// out of bmi270.c of github.com/boschsensortec/BMI270_SensorAPI into a file bmi270_config.h beside this sketch:
//   const uint8_t bmi270_config_file[] PROGMEM = { 0xc8, 0x2e, ... };
#include <GnomonImu.h>

#include "bmi270_config.h"

const uint8_t ADDRESS = 0x68;  // 0x69 where SDO is high
const float FORCE = gnomon::G / 8192, RATE = gnomon::DEGREE / 65.536f;

static void loadConfiguration() {
  for (uint16_t place = 0; place < sizeof bmi270_config_file; place += 16) {
    gnomon::writeRegister(ADDRESS, 0x5B, (place / 2) & 0x0F);  // INIT_ADDR_0, in words
    gnomon::writeRegister(ADDRESS, 0x5C, (place / 2) >> 4);    // INIT_ADDR_1
    Wire.beginTransmission(ADDRESS);
    Wire.write(0x5E);  // INIT_DATA
    for (uint8_t i = 0; i < 16; i++) Wire.write(pgm_read_byte(bmi270_config_file + place + i));
    Wire.endTransmission();
  }
}

void setup() {
  gnomon::begin("BMI270", ADDRESS, 0x00, 0x24);  // CHIP_ID
  gnomon::writeRegister(ADDRESS, 0x7E, 0xB6);  // CMD: reset
  delay(5);
  gnomon::writeRegister(ADDRESS, 0x7C, 0x00);  // PWR_CONF: no power saving
  delay(1);
  gnomon::writeRegister(ADDRESS, 0x59, 0x00);  // INIT_CTRL: prepare
  loadConfiguration();
  gnomon::writeRegister(ADDRESS, 0x59, 0x01);  // INIT_CTRL: done
  delay(150);
  if ((gnomon::readRegister(ADDRESS, 0x21) & 0x0F) != 0x01) {  // INTERNAL_STATUS
    Serial.print("# BMI270: its configuration was not accepted; is bmi270_config.h Bosch's?\n");
    while (true) delay(1000);
  }
  gnomon::writeRegister(ADDRESS, 0x7D, 0x0E);  // PWR_CTRL: accelerometer, gyroscope, temperature
  gnomon::writeRegister(ADDRESS, 0x40, 0xA9);  // ACC_CONF: 200 Hz, normal filter, performance
  gnomon::writeRegister(ADDRESS, 0x41, 0x01);  // ACC_RANGE: 4 g, 8192 LSB/g
  gnomon::writeRegister(ADDRESS, 0x42, 0xE9);  // GYR_CONF: 200 Hz, normal filter, performance
  gnomon::writeRegister(ADDRESS, 0x43, 0x02);  // GYR_RANGE: 500 deg/s, 65.536 LSB/(deg/s)
}

void loop() {
  if ((gnomon::readRegister(ADDRESS, 0x03) & 0xC0) != 0xC0) return;  // STATUS: both are ready
  const unsigned long stamp_us = micros();
  uint8_t data[12], warmth[2];
  if (!gnomon::readRegisters(ADDRESS, 0x0C, data, sizeof data)) return;  // acceleration, rate
  gnomon::readRegisters(ADDRESS, 0x22, warmth, sizeof warmth);
  gnomon::Sample sample;
  for (uint8_t i = 0; i < 3; i++) {
    sample.accel[i] = gnomon::littleEndian(data + 2 * i);
    sample.gyro[i] = gnomon::littleEndian(data + 6 + 2 * i);
  }
  sample.temperature = gnomon::littleEndian(warmth);
  gnomon::send(stamp_us, sample, FORCE, RATE, sample.temperature / 512.0f + 23);
}
