// An error-state Kalman filter of twelve states in plain C++17, as a program that insdvl-replay judges.
//
//   c++ -O2 -std=c++17 -o error_state_filter error_state_filter.cpp
//   program = ["./error_state_filter", "{dive}", "{start}", "{solution}"]
//
// States: velocity in n, misalignment in n (estimated minus true), biases of accelerometers and gyros (true minus
// estimated). n is north-east-down, b forward-starboard-down. Everything is SI.
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

using Vector = std::array<double, 3>;
using Matrix = std::array<Vector, 3>;
constexpr double kDeg = M_PI / 180.0, kEarthRate = 7.292115e-5, kSemiMajor = 6378137.0, kEccentricity2 = 6.69437999e-3;
constexpr int kStates = 12;
constexpr double kRowsEvery = 0.1;  // seconds between rows of the solution

// Noise: change it to that of your sensors.
double accel_white = 5e-3, gyro_white = 4.4e-5, dvl_sd = 0.02;  // m/s/sqrt(s), rad/sqrt(s), m/s
constexpr double kAccelWalk = 2e-5, kGyroWalk = 8e-8;           // m/s^2/sqrt(s), rad/s/sqrt(s)

Vector cross(const Vector& a, const Vector& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
Vector plus(const Vector& a, const Vector& b, double factor = 1.0) {
  return {a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]};
}
Vector rotate(const Matrix& m, const Vector& v) {
  Vector out{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[i] += m[i][j] * v[j];
  return out;
}
Vector rotate_back(const Matrix& m, const Vector& v) {
  Vector out{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[i] += m[j][i] * v[j];
  return out;
}
Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix out{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k) out[i][j] += a[i][k] * b[k][j];
  return out;
}
Matrix turn(const Vector& v) {  // the rotation by a vector
  double angle = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  double s = angle > 1e-8 ? std::sin(angle) / angle : 1.0;
  double c = angle > 1e-8 ? (1.0 - std::cos(angle)) / (angle * angle) : 0.5;
  Matrix k{{{0, -v[2], v[1]}, {v[2], 0, -v[0]}, {-v[1], v[0], 0}}}, square = multiply(k, k), out{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[i][j] = (i == j) + s * k[i][j] + c * square[i][j];
  return out;
}

// --- The files.

struct Reading {
  int64_t time_ns;
  Vector first, second;  // IMU: angular rate and specific force; DVL: velocity
};

struct Dive {
  std::vector<Reading> imu, dvl;
};

std::vector<char> read_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot read " + path);
  return {std::istreambuf_iterator<char>(file), {}};
}

template <typename T>
T take(const char*& at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  at += sizeof value;
  return value;
}

std::string take_string(const char*& at) {
  uint32_t size = take<uint32_t>(at);
  std::string text(at, size);
  at += size;
  return text;
}

// The stamp of a ROS 2 message, and its numbers: they follow the header, aligned to eight bytes.
Reading read_message(const char* data, bool is_imu) {
  const char *body = data + 4, *at = body;
  int64_t seconds = take<int32_t>(at), nanoseconds = take<uint32_t>(at);
  take_string(at);
  at = body + (at - body + 7) / 8 * 8;
  auto number = [&](int place) {
    const char* there = at + 8 * place;
    return take<double>(there);
  };
  auto three = [&](int place) { return Vector{number(place), number(place + 1), number(place + 2)}; };
  int64_t time_ns = seconds * 1000000000 + nanoseconds;
  return is_imu ? Reading{time_ns, three(13), three(25)} : Reading{time_ns, three(0), {}};
}

// MCAP without compression: chunks with channels and messages.
void read_records(const char* at, const char* end, std::vector<std::string>& topics, Dive& dive) {
  while (at + 9 <= end) {
    auto kind = take<uint8_t>(at);
    auto size = take<uint64_t>(at);
    const char *record = at, *next = at + size;
    if (kind == 4) {
      auto channel = take<uint16_t>(record);
      take<uint16_t>(record);
      if (topics.size() <= channel) topics.resize(channel + 1);
      topics[channel] = take_string(record);
    } else if (kind == 5) {
      const std::string& topic = topics.at(take<uint16_t>(record));
      record += 4 + 8 + 8;
      if (topic == "/imu") dive.imu.push_back(read_message(record, true));
      if (topic == "/dvl") dive.dvl.push_back(read_message(record, false));
    } else if (kind == 6) {
      record += 8 + 8 + 8 + 4;
      if (!take_string(record).empty()) throw std::runtime_error("the dive is compressed");
      auto length = take<uint64_t>(record);
      read_records(record, record + length, topics, dive);
    }
    at = next;
  }
}

// The numbers of a key in JSON.
std::vector<double> numbers(const std::string& text, const std::string& key) {
  size_t at = text.find('"' + key + '"');
  if (at == std::string::npos) throw std::runtime_error("no " + key + " in the start");
  at = text.find(':', at) + 1;
  std::vector<double> found;
  const char* place = text.c_str() + at;
  bool is_list = false;
  for (;; ++place) {
    if (*place == '[') is_list = true;
    if (*place == '\0' || *place == ']' || (!is_list && !found.empty())) break;
    if (*place == '-' || std::isdigit(*place)) {
      char* end;
      found.push_back(std::strtod(place, &end));
      place = end - 1;
    }
  }
  return found;
}

Vector three(const std::string& text, const std::string& key) {
  auto found = numbers(text, key);
  return {found.at(0), found.at(1), found.at(2)};
}

// --- The filter.

struct Filter {
  double latitude, longitude, height;
  Vector velocity_n, accel_bias, gyro_bias, arm_b;
  Matrix mat_nb;
  std::array<std::array<double, kStates>, kStates> P{};

  Vector earth_rate_n() const { return {kEarthRate * std::cos(latitude), 0, -kEarthRate * std::sin(latitude)}; }

  explicit Filter(const std::string& start) {
    latitude = numbers(start, "latitude_deg").at(0) * kDeg;
    longitude = numbers(start, "longitude_deg").at(0) * kDeg;
    height = numbers(start, "height_m").at(0);
    velocity_n = three(start, "velocity_ned_mps");
    accel_bias = three(start, "accelerometer_bias_mps2");
    gyro_bias = three(start, "gyro_bias_radps");
    arm_b = three(start, "dvl_lever_arm_m");
    Vector rpy = three(start, "roll_pitch_heading_deg"), rpy_sd = three(start, "roll_pitch_heading_deg_sd");
    Matrix heading = turn({0, 0, rpy[2] * kDeg});
    mat_nb = multiply(heading, multiply(turn({0, rpy[1] * kDeg, 0}), turn({rpy[0] * kDeg, 0, 0})));
    const char* keys[] = {"velocity_ned_mps_sd", "", "accelerometer_bias_mps2_sd", "gyro_bias_radps_sd"};
    for (int block : {0, 2, 3})
      for (int i = 0; i < 3; ++i) P[3 * block + i][3 * block + i] = std::pow(three(start, keys[block])[i], 2);
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        for (int k = 0; k < 3; ++k) P[3 + i][3 + j] += heading[i][k] * heading[j][k] * std::pow(rpy_sd[k] * kDeg, 2);
  }

  void propagate(const Vector& rate, const Vector& force, double dt) {
    double sine = std::sin(latitude), root = std::sqrt(1.0 - kEccentricity2 * sine * sine);
    double north_m = kSemiMajor * (1.0 - kEccentricity2) / std::pow(root, 3) + height;
    double east_m = kSemiMajor / root + height;
    double gravity = 9.7803253359 * (1.0 + 0.00193185265241 * sine * sine) / root - 3.086e-6 * height;
    Vector v = velocity_n, transport_n = {v[1] / east_m, -v[0] / north_m, -v[1] * std::tan(latitude) / east_m};
    Vector rate_in_n = plus(earth_rate_n(), transport_n);
    Matrix before = mat_nb;
    mat_nb = multiply(turn(plus({}, rate_in_n, -dt)), multiply(mat_nb, turn(plus({}, plus(rate, gyro_bias, -1), dt))));
    Vector force_b = plus(force, accel_bias, -1), force_n = plus(rotate(before, force_b), rotate(mat_nb, force_b));
    force_n = plus({}, force_n, 0.5);
    Vector acceleration = plus(force_n, cross(plus(earth_rate_n(), rate_in_n), v), -1);
    acceleration[2] += gravity;
    velocity_n = plus(v, acceleration, dt);
    Vector mean = plus({}, plus(v, velocity_n), 0.5);
    latitude += mean[0] * dt / north_m;
    longitude += mean[1] * dt / (east_m * std::cos(latitude));
    height -= mean[2] * dt;

    // P <- Phi P Phi' + Q, with Phi = I + F dt.
    auto step = [&](auto get, auto set) {
      Vector dv{get(0), get(1), get(2)}, phi{get(3), get(4), get(5)};
      Vector ba{get(6), get(7), get(8)}, bg{get(9), get(10), get(11)};
      Vector dv_rate = plus(plus(cross(phi, force_n), rotate(mat_nb, ba)), cross(plus(earth_rate_n(), rate_in_n), dv), -1);
      Vector phi_rate = plus(rotate(mat_nb, bg), cross(rate_in_n, phi), -1);
      for (int i = 0; i < 3; ++i) set(i, dv[i] + dt * dv_rate[i]), set(3 + i, phi[i] + dt * phi_rate[i]);
    };
    for (int c = 0; c < kStates; ++c) step([&](int i) { return P[i][c]; }, [&](int i, double x) { P[i][c] = x; });
    for (int r = 0; r < kStates; ++r) step([&](int i) { return P[r][i]; }, [&](int i, double x) { P[r][i] = x; });
    const double density[] = {accel_white, gyro_white, kAccelWalk, kGyroWalk};
    for (int i = 0; i < kStates; ++i) P[i][i] += density[i / 3] * density[i / 3] * dt;
  }

  // Use a velocity of the DVL, axis by axis.
  void update(const Vector& measured, const Vector& rate) {
    Vector rate_b = plus(plus(rate, gyro_bias, -1), rotate_back(mat_nb, earth_rate_n()), -1);
    Vector predicted = plus(rotate_back(mat_nb, velocity_n), cross(rate_b, arm_b));
    std::array<double, kStates> dx{};
    for (int axis = 0; axis < 3; ++axis) {
      Vector north{mat_nb[0][axis], mat_nb[1][axis], mat_nb[2][axis]}, by_phi = cross(north, velocity_n), unit{};
      unit[axis] = 1.0;
      Vector by_gyro = cross(arm_b, unit);
      std::array<double, kStates> H{}, PH{};
      for (int i = 0; i < 3; ++i) H[i] = north[i], H[3 + i] = by_phi[i], H[9 + i] = by_gyro[i];
      double innovation = predicted[axis] - measured[axis], S = dvl_sd * dvl_sd;
      for (int i = 0; i < kStates; ++i)
        for (int j = 0; j < kStates; ++j) PH[i] += P[i][j] * H[j];
      for (int i = 0; i < kStates; ++i) S += H[i] * PH[i], innovation -= H[i] * dx[i];
      for (int i = 0; i < kStates; ++i) {
        dx[i] += PH[i] / S * innovation;
        for (int j = 0; j < kStates; ++j) P[i][j] -= PH[i] * PH[j] / S;
      }
    }
    for (int i = 0; i < 3; ++i) velocity_n[i] -= dx[i], accel_bias[i] += dx[6 + i], gyro_bias[i] += dx[9 + i];
    mat_nb = multiply(turn({-dx[3], -dx[4], -dx[5]}), mat_nb);
  }

  void write_row(std::FILE* file, int64_t time_ns) const {
    double heading = std::atan2(mat_nb[1][0], mat_nb[0][0]), c = std::cos(heading), s = std::sin(heading);
    double roll_var = c * c * P[3][3] + s * s * P[4][4] + 2 * c * s * P[3][4];
    double pitch_var = s * s * P[3][3] + c * c * P[4][4] - 2 * c * s * P[3][4];
    std::fprintf(file, "%lld,%.12f,%.12f,%.6f,%.9f,%.9f,%.9f,%.9f,%.9f,%.9f,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n",
                 static_cast<long long>(time_ns), latitude / kDeg, longitude / kDeg, height, velocity_n[0],
                 velocity_n[1], velocity_n[2], std::atan2(mat_nb[2][1], mat_nb[2][2]) / kDeg,
                 -std::asin(mat_nb[2][0]) / kDeg, heading / kDeg, std::sqrt(P[0][0]), std::sqrt(P[1][1]),
                 std::sqrt(P[2][2]), std::sqrt(roll_var) / kDeg, std::sqrt(pitch_var) / kDeg,
                 std::sqrt(P[5][5]) / kDeg);
  }
};

// Go through a dive from a time on; `after_each` is told the time after each reading of the IMU, and which is the last.
template <typename AfterEach>
void go_through(const Dive& dive, Filter& filter, int64_t now_ns, AfterEach after_each) {
  size_t ping = 0;
  while (ping < dive.dvl.size() && dive.dvl[ping].time_ns <= now_ns) ++ping;
  for (size_t i = 1; i < dive.imu.size(); ++i) {
    const Reading &before = dive.imu[i - 1], &after = dive.imu[i];
    if (after.time_ns <= now_ns) continue;
    Vector rate = plus({}, plus(before.first, after.first), 0.5), force = plus({}, plus(before.second, after.second), 0.5);
    while (now_ns < after.time_ns) {
      bool is_ping = ping < dive.dvl.size() && dive.dvl[ping].time_ns <= after.time_ns;
      int64_t next_ns = is_ping ? dive.dvl[ping].time_ns : after.time_ns;
      filter.propagate(rate, force, (next_ns - now_ns) * 1e-9);
      if (is_ping) filter.update(dive.dvl[ping++].first, rate);
      now_ns = next_ns;
    }
    after_each(now_ns, i + 1 == dive.imu.size());
  }
}

int main(int count, char** words) {
  if (count < 4) return std::fprintf(stderr, "usage: %s DIVE START SOLUTION [ACCEL_WHITE GYRO_WHITE DVL_SD]\n", words[0]), 2;
  double* noise[] = {&accel_white, &gyro_white, &dvl_sd};
  for (int i = 4; i < count && i < 7; ++i) *noise[i - 4] = std::atof(words[i]);
  try {
    std::vector<char> data = read_file(words[1]), json = read_file(words[2]);
    std::string start(json.begin(), json.end());
    std::vector<std::string> topics;
    Dive dive;
    read_records(data.data() + 8, data.data() + data.size() - 8, topics, dive);
    Filter filter(start);
    int64_t now_ns = std::strtoll(start.c_str() + start.find(':', start.find("\"time_ns\"")) + 1, nullptr, 10);
    int64_t row_ns = now_ns;
    std::FILE* file = std::fopen(words[3], "w");
    if (!file) throw std::runtime_error("cannot write the solution");
    std::fprintf(file, "time_ns,latitude_deg,longitude_deg,height_m,velocity_n_mps,velocity_e_mps,velocity_d_mps,roll_deg,"
                 "pitch_deg,heading_deg,velocity_n_mps_sd,velocity_e_mps_sd,velocity_d_mps_sd,roll_deg_sd,pitch_deg_sd,"
                 "heading_deg_sd\n");
    go_through(dive, filter, now_ns, [&](int64_t time_ns, bool is_last) {
      if (time_ns < row_ns && !is_last) return;
      filter.write_row(file, time_ns);
      row_ns = time_ns + static_cast<int64_t>(kRowsEvery * 1e9);
    });
    std::fclose(file);
  } catch (const std::exception& error) {
    return std::fprintf(stderr, "%s\n", error.what()), 1;
  }
}
