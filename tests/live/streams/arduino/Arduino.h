// As much of a board as the sketch in docs/how-to/arduino.md needs, in a time of its own, with a plant between its pins:
// 0.3 s dy/dt = 4 u - y.  What it prints goes to standard output.
#include <cmath>
#include <cstdio>
#include <cstdlib>

const int A0 = 14;
static unsigned long now = 4294000000UL;  // us; wraps after a second, as it does every 71 minutes on a board
static double plant_input = 0.0, plant_output = 0.0;

inline void pass(unsigned long time) {
  plant_output += (4.0 * plant_input - plant_output) * (1.0 - std::exp(-1e-6 * time / 0.3));
  now = (now + time) & 0xFFFFFFFFUL;  // 32 bits, as on a board
}
inline unsigned long micros() { pass(20); return now; }
inline int analogRead(int) { return (int)std::floor(plant_output + 0.5); }
inline void analogWrite(int, int value) { plant_input = value; }
inline long random(long low, long high) { return low + std::rand() % (high - low); }

struct Port {
  long lines = 0;
  void begin(long) {}
  void print(const char *line) {
    std::fputs(line, stdout);
    if (++lines % 500 == 0) pass(13000);  // something else took its time
  }
} Serial;

void setup();
void loop();

int main(int, char **arguments) {
  setup();
  while (Serial.lines < std::atol(arguments[1])) loop();
}
