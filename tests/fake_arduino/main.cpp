// Runs a sketch against a sensor that is played by its registers: what it measures, in SI units, comes from the standard
// input, and is put into the data registers with the full scale and at the rate that the sketch has configured.
#include <math.h>

#include SKETCH

uint64_t fake_clock_us = (1ull << 32) - 300000;  // micros() begins again after 0.3 s
FakeSerial Serial;
FakeWire Wire;

static uint8_t registers[4][256];  // by bank
static int fake_bank = 0, polled = 0;
static bool done = false;

struct Layout {
  uint8_t address, id_register, id, ready_register, ready, accel, gyro, temperature;
  bool big_endian;
};

#if defined(MPU6050) || defined(MPU9250)
#ifdef MPU6050
static const Layout chip = {0x68, 0x75, 0x68, 0x3A, 0x01, 0x3B, 0x43, 0x41, true};
static double celsius_counts(double celsius) { return (celsius - 36.53) * 340; }
#else
static const Layout chip = {0x68, 0x75, 0x71, 0x3A, 0x01, 0x3B, 0x43, 0x41, true};
static double celsius_counts(double celsius) { return (celsius - 21) * 333.87; }
#endif
static double g_counts() { return 16384 >> (registers[0][0x1C] >> 3 & 3); }
static double dps_counts() { return 131.0 / (1 << (registers[0][0x1B] >> 3 & 3)); }
static double rate_hz() { return (registers[0][0x1A] & 7 ? 1000.0 : 8000.0) / (1 + registers[0][0x19]); }
static bool running() { return registers[0][0x6B] == 0x01 && registers[0][0x38] & 1; }
#elif defined(ICM20948)
static const Layout chip = {0x69, 0x00, 0xEA, 0x1A, 0x01, 0x2D, 0x33, 0x39, true};
static double celsius_counts(double celsius) { return (celsius - 21) * 333.87; }
static double g_counts() { return 16384 >> (registers[2][0x14] >> 1 & 3); }
static double dps_counts() { return 131.0 / (1 << (registers[2][0x01] >> 1 & 3)); }
static double rate_hz() {
  bool filtered = registers[2][0x01] & registers[2][0x14] & 1, same = registers[2][0x00] == registers[2][0x11];
  return filtered && same && registers[2][0x10] == 0 ? 1125.0 / (1 + registers[2][0x00]) : 0;
}
static bool running() { return registers[0][0x06] == 0x01 && registers[0][0x11] & 1; }
#elif defined(LSM6DSO)
static const Layout chip = {0x6A, 0x0F, 0x6C, 0x1E, 0x03, 0x28, 0x22, 0x20, false};
static double celsius_counts(double celsius) { return (celsius - 25) * 256; }
static double g_counts() {
  const double mg[] = {0.061, 0.488, 0.122, 0.244};  // 2, 16, 4, 8 g
  return 1000 / mg[registers[0][0x10] >> 2 & 3];
}
static double dps_counts() {
  const double mdps[] = {8.75, 17.5, 35, 70};
  return 1000 / mdps[registers[0][0x11] >> 2 & 3];
}
static double rate_hz() {
  int accel = registers[0][0x10] >> 4, gyro = registers[0][0x11] >> 4;
  return accel == gyro ? 13.0 * (1 << (accel - 1)) : 0;
}
static bool running() { return registers[0][0x12] == 0x44; }
#elif defined(BMI270)
static const Layout chip = {0x68, 0x00, 0x24, 0x03, 0xC0, 0x0C, 0x12, 0x22, false};
static int loaded = 0;
static double celsius_counts(double celsius) { return (celsius - 23) * 512; }
static double g_counts() { return 16384 >> (registers[0][0x41] & 3); }
static double dps_counts() { return 32768.0 / (2000 >> (registers[0][0x43] & 7)); }
static double rate_hz() {
  int accel = registers[0][0x40] & 15, gyro = registers[0][0x42] & 15;
  return accel == gyro ? 25.0 * (1 << (accel - 6)) : 0;
}
static bool running() { return (registers[0][0x21] & 15) == 1 && registers[0][0x7D] == 0x0E && registers[0][0x7C] == 0; }
#endif

static void put(uint8_t reg, double counts) {
  long value = lround(counts);
  value = value > 32767 ? 32767 : value < -32768 ? -32768 : value;
  registers[0][reg + (chip.big_endian ? 1 : 0)] = value & 0xFF;
  registers[0][reg + (chip.big_endian ? 0 : 1)] = value >> 8 & 0xFF;
}

static void measure() {
  double v[7];
  for (int i = 0; i < 7; i++)
    if (scanf("%lf", v + i) != 1) {
      done = true;
      return;
    }
  const double degree = 3.14159265358979323846 / 180;
  for (int i = 0; i < 3; i++) {
    put(chip.accel + 2 * i, v[i] / 9.80665 * g_counts());
    put(chip.gyro + 2 * i, v[3 + i] / degree * dps_counts());
  }
  put(chip.temperature, celsius_counts(v[6]));
  registers[0][chip.ready_register] = chip.ready;
}

void FakeWire::beginTransmission(uint8_t address) { address_ = address, count_ = 0; }
size_t FakeWire::write(uint8_t value) { return count_ < 32 ? (sent_[count_++] = value, 1) : 0; }  // as long as AVR's

uint8_t FakeWire::endTransmission(bool) {
  if (address_ != chip.address) return 2;
  reg_ = sent_[0];
  for (uint8_t i = 1; i < count_; i++) {
#if defined(ICM20948)
    if (reg_ == 0x7F) {
      fake_bank = sent_[i] >> 4 & 3;
      continue;
    }
#elif defined(BMI270)
    if (reg_ == 0x5E) {  // the configuration: 16 bytes at a time, at the address in words that was written before
      int place = 2 * (registers[0][0x5B] | registers[0][0x5C] << 4) + i - 1;
      if (place == loaded && sent_[i] == bmi270_config_file[place]) loaded++;
      continue;
    }
    if (reg_ == 0x59 && sent_[i] == 1) registers[0][0x21] = loaded == 8192 ? 1 : 2;
#endif
    registers[fake_bank][reg_++] = sent_[i];
  }
  return 0;
}

uint8_t FakeWire::requestFrom(uint8_t address, uint8_t count) {
  if (address != chip.address || count > 32) return 0;
  registers[0][chip.id_register] = chip.id;
  if (reg_ == chip.ready_register && fake_bank == 0 && running()) {
    registers[0][reg_] = 0;
    if (polled++ % 2) {  // every other question finds a new sample
      fake_clock_us += lround(1e6 / rate_hz());
      measure();
    }
  }
  return count;
}

int FakeWire::read() { return registers[fake_bank][reg_++]; }

int main() {
  setup();
  while (!done) loop();
}
