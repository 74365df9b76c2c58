// Drive a robot with policy.onnx: the loop of docs/deploy.md in C++17, with ONNX Runtime.
//
//     g++ -std=c++17 -O2 control_loop.cpp -I ORT/include -L ORT/lib -lonnxruntime -o control_loop
//     LD_LIBRARY_PATH=ORT/lib ./control_loop out/policy.onnx < states.txt
//
// ORT is an unpacked release of ONNX Runtime. As it stands, the program reads states from standard
// input and prints joint targets. For a robot, replace read_state, send_targets and stop_motors by
// calls of its SDK. Joints are in the order of the metadata's joint_names.

#include <onnxruntime_cxx_api.h>

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <deque>
#include <functional>
#include <iostream>
#include <limits>
#include <map>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

using Joints = std::array<double, 12>;
using Numbers = std::vector<double>;

const double MAX_TILT = 1.0;  // rad, of the trunk; beyond it the motors stop

// What a robot measures in one control step.
struct State {
  std::array<double, 4> quaternion;        // wxyz, from the trunk's frame to the world's
  std::array<double, 3> angular_velocity;  // of the gyroscope, trunk's frame, rad/s
  Joints angle;                            // rad
  Joints speed;                            // rad/s
  std::array<double, 3> command;           // m/s ahead and to the left, rad/s to the left
};

// Return the world's downward direction in the trunk's frame: (0, 0, -1) if it is level.
Numbers compute_gravity(const State& state) {
  const auto [w, x, y, z] = state.quaternion;
  return {2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1};
}

// Return the angle about the vertical, rad, from -pi to pi.
double compute_heading(const State& state) {
  const auto [w, x, y, z] = state.quaternion;
  return std::atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z));
}

// Return the texts between quotation marks of a JSON list.
std::vector<std::string> read_words(const std::string& json) {
  std::vector<std::string> words;
  size_t begin = json.find('"');
  while (begin != std::string::npos) {
    const size_t end = json.find('"', begin + 1);
    words.push_back(json.substr(begin + 1, end - begin - 1));
    begin = json.find('"', end + 1);
  }
  return words;
}

// Return the numbers of a JSON list; null, which stands for no limit, becomes infinity.
Numbers read_numbers(const std::string& json) {
  Numbers numbers;
  size_t begin = 1;
  while (begin < json.size()) {
    const size_t end = json.find_first_of(",]", begin);
    const std::string text = json.substr(begin, end - begin);
    const bool is_null = text.find("null") != std::string::npos;
    numbers.push_back(is_null ? std::numeric_limits<double>::infinity() : std::stod(text));
    begin = end + 1;
  }
  return numbers;
}

// The policy in one episode.
class Controller {
 public:
  Numbers kp, kd;  // Nm/rad and Nm s/rad, of each joint
  double period;   // s, of a control step

  explicit Controller(const std::string& file)
      : session(environment, file.c_str(), Ort::SessionOptions{}) {
    kp = read_numbers(read_entry("joint_stiffness"));
    kd = read_numbers(read_entry("joint_damping"));
    home = read_numbers(read_entry("default_joint_pos"));
    history = read_numbers(read_entry("observation_history"));
    period = std::stod(read_entry("control_period"));
    names = read_words(read_entry("observation_functions"));
    readings.resize(names.size());
    for (const std::string& name : names) {
      if (observations.count(name) == 0) {
        throw std::runtime_error("add " + name + " to observations");
      }
      if (name == "observation:trot_clock") {
        const std::string params = read_entry("observation_params");
        stride = std::stod(params.substr(params.find("\"stride\":") + 9));
      }
    }
  }

  // Return joint targets, rad, for one control step.
  Joints compute_targets(const State& state) {
    std::vector<float> input = observe(state);
    const std::array<int64_t, 2> shape{1, static_cast<int64_t>(input.size())};
    const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
    const auto tensor = Ort::Value::CreateTensor<float>(memory, input.data(), input.size(),
                                                        shape.data(), shape.size());
    const char* inputs[] = {"obs"};
    const char* outputs[] = {"actions", "joint_targets"};
    const auto results = session.Run(Ort::RunOptions{}, inputs, &tensor, 1, outputs, 2);
    const float* actions = results[0].GetTensorData<float>();
    const float* targets = results[1].GetTensorData<float>();
    last_action.assign(actions, actions + 12);
    steps += 1;
    Joints joint_targets;
    std::copy(targets, targets + 12, joint_targets.begin());
    return joint_targets;
  }

 private:
  Ort::Env environment;
  Ort::Session session;
  Numbers home, history;
  std::vector<std::string> names;
  std::vector<std::deque<Numbers>> readings;  // of each observation, from the oldest to the newest
  Numbers last_action = Numbers(12, 0.0);
  double stride = 1.0;  // control steps of a trot's stride
  int steps = 0;        // since the start
  double first_heading = 0.0;

  // The parts of the observation by their names in the metadata. Add those of your own task here.
  const std::map<std::string, std::function<Numbers(const State&)>> observations = {
      {"observation:angular_velocity",
       [](const State& s) { return to_numbers(s.angular_velocity); }},
      {"observation:gravity", compute_gravity},
      {"observation:heading",
       [this](const State& s) {
         return Numbers{std::remainder(compute_heading(s) - first_heading, 2 * M_PI)};
       }},
      {"observation:command", [](const State& s) { return to_numbers(s.command); }},
      {"observation:trot_clock", [this](const State& s) { return compute_clock(s); }},
      {"observation:joint_pos", [this](const State& s) { return subtract_home(s.angle); }},
      {"observation:joint_vel", [](const State& s) { return to_numbers(s.speed); }},
      {"observation:last_action", [this](const State&) { return last_action; }},
  };

  template <class Array>
  static Numbers to_numbers(const Array& values) {
    return Numbers(values.begin(), values.end());
  }

  std::string read_entry(const char* key) {
    Ort::AllocatorWithDefaultOptions allocator;
    const auto text = session.GetModelMetadata().LookupCustomMetadataMapAllocated(key, allocator);
    if (!text) throw std::runtime_error(std::string("policy.onnx has no ") + key);
    return text.get();
  }

  Numbers subtract_home(const Joints& angle) const {
    Numbers difference(12);
    for (int joint = 0; joint < 12; joint++) difference[joint] = angle[joint] - home[joint];
    return difference;
  }

  // Return sine and cosine of a trot's phase; 0 at the command to stand.
  Numbers compute_clock(const State& state) const {
    if (state.command == std::array<double, 3>{}) return {0.0, 0.0};
    const double phase = 2 * M_PI * steps / stride;
    return {std::sin(phase), std::cos(phase)};
  }

  // Return the observation: part after part, each from its oldest control step to the newest.
  std::vector<float> observe(const State& state) {
    if (steps == 0) first_heading = compute_heading(state);
    std::vector<float> input;
    for (size_t part = 0; part < names.size(); part++) {
      std::deque<Numbers>& frames = readings[part];
      const Numbers reading = observations.at(names[part])(state);
      const size_t count = 1 + static_cast<size_t>(history[part]);
      frames.push_back(reading);
      while (frames.size() < count) frames.push_back(reading);  // at the start all are the first
      if (frames.size() > count) frames.pop_front();
      for (const Numbers& frame : frames) input.insert(input.end(), frame.begin(), frame.end());
    }
    return input;
  }
};

// Return true if all numbers are finite and the trunk leans by less than MAX_TILT.
bool is_safe(const State& state, const Joints& targets) {
  const double upright = -compute_gravity(state)[2];
  double sum = 0.0;
  for (int joint = 0; joint < 12; joint++) {
    sum += state.angle[joint] + state.speed[joint] + targets[joint];
  }
  return std::isfinite(sum) && upright > std::cos(MAX_TILT);
}

// Read a state: the 34 numbers of State in their order. Return false at the end of the input.
bool read_state(State& state) {
  for (double& value : state.quaternion) std::cin >> value;
  for (double& value : state.angular_velocity) std::cin >> value;
  for (double& value : state.angle) std::cin >> value;
  for (double& value : state.speed) std::cin >> value;
  for (double& value : state.command) std::cin >> value;
  return static_cast<bool>(std::cin);
}

// Send targets with the gains of training, speed 0 and torque 0. Here: print the targets.
void send_targets(const Joints& targets, const Numbers& /*kp*/, const Numbers& /*kd*/) {
  for (double target : targets) std::printf("%.7f ", target);
  std::printf("\n");
}

// Send gains of 0 and some damping. Here: nothing.
void stop_motors() {}

// Run the policy until the input ends or a state is unsafe.
void run(const char* file) {
  Controller controller(file);
  State state;
  auto next = std::chrono::steady_clock::now();
  while (read_state(state)) {
    const Joints targets = controller.compute_targets(state);
    if (!is_safe(state, targets)) {
      stop_motors();
      throw std::runtime_error("unsafe state, motors stopped");
    }
    send_targets(targets, controller.kp, controller.kd);
    next += std::chrono::microseconds(static_cast<int64_t>(1e6 * controller.period));
    std::this_thread::sleep_until(next);
  }
}

int main(int count, char** arguments) {
  if (count != 2) {
    std::fprintf(stderr, "usage: control_loop policy.onnx < states.txt\n");
    return 2;
  }
  try {
    run(arguments[1]);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n", error.what());
    return 1;
  }
}
