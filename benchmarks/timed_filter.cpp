// How long the filter of examples/candidates/error_state_filter.cpp takes for the readings of a file, in seconds of
// processor time: the fastest of some runs, then the standard deviations of the six biases at the end.
//
//   timed_filter READINGS START RUNS ACCEL_WHITE GYRO_WHITE DVL_SD
//
// READINGS has rows of eight doubles: 0 for the IMU or 1 for the DVL, seconds since the start, and six numbers in b.
// Only `main` itself may end without a return.
#pragma GCC diagnostic ignored "-Wreturn-type"
#define main main_of_the_example
#include "error_state_filter.cpp"
#undef main

#include <algorithm>
#include <ctime>
#include <limits>

double processor_s() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

Dive readings_of(const std::string& path) {
  std::vector<char> data = read_file(path);
  const char *at = data.data(), *end = at + data.size();
  Dive dive;
  while (at < end) {
    bool is_ping = take<double>(at) > 0.5;
    Reading reading;
    reading.time_ns = std::llround(take<double>(at) * 1e9);
    for (double& value : reading.first) value = take<double>(at);
    for (double& value : reading.second) value = take<double>(at);
    (is_ping ? dive.dvl : dive.imu).push_back(reading);
  }
  return dive;
}

int main(int, char** words) {
  Dive dive = readings_of(words[1]);
  std::vector<char> json = read_file(words[2]);
  std::string start(json.begin(), json.end());
  accel_white = std::atof(words[4]);
  gyro_white = std::atof(words[5]);
  dvl_sd = std::atof(words[6]);
  double least_s = std::numeric_limits<double>::infinity();
  Filter filter(start);
  for (int left = std::atoi(words[3]); left > 0; --left) {
    filter = Filter(start);
    double start_s = processor_s();
    go_through(dive, filter, 0, [](int64_t, bool) {});
    least_s = std::min(least_s, processor_s() - start_s);
  }
  std::printf("%.9g", least_s);
  for (int i = 6; i < kStates; ++i) std::printf(" %.9g", std::sqrt(filter.P[i][i]));
  std::printf("\n");
}
