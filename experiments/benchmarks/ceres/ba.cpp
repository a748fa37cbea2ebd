// One bundle adjustment by Ceres: ba PROBLEM dense|sparse TOLERANCE THREADS
//
// Reads a file written by `problem.write_problem` and prints one JSON object. Plain least squares, costs by automatic
// differentiation, points eliminated first. Every stopping rule but the function tolerance is switched off.

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// Not getrusage: its maximum counts what the parent held before it started this program.
double peak_mb() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    double kilobytes = 0.0;
    if (word == "VmHWM:" && status >> kilobytes) return kilobytes / 1024.0;
  }
  return -1.0;
}

struct Observations {
  int64_t parameters = 0, cameras = 0, points = 0, count = 0;
  std::vector<int32_t> camera_of, point_of;
  std::vector<double> pixels, camera, point;
};

template <typename T>
std::vector<T> take(std::ifstream& file, int64_t count) {
  std::vector<T> values(count);
  file.read(reinterpret_cast<char*>(values.data()), count * sizeof(T));
  if (!file) throw std::runtime_error("the problem file is missing or too short");
  return values;
}

Observations read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const auto counts = take<int64_t>(file, 4);
  Observations all;
  all.parameters = counts[0], all.cameras = counts[1], all.points = counts[2], all.count = counts[3];
  all.camera_of = take<int32_t>(file, all.count);
  all.point_of = take<int32_t>(file, all.count);
  all.pixels = take<double>(file, 2 * all.count);
  all.camera = take<double>(file, all.cameras * all.parameters);
  all.point = take<double>(file, all.points * 3);
  return all;
}

// Where the point meets the plane of unit depth; the axis along which the camera looks is +z, or -z in BAL.
template <typename T>
void on_plane(const T* camera, const T* point, double forward, T* place) {
  T local[3];
  ceres::AngleAxisRotatePoint(camera, point, local);
  const T depth = forward * (local[2] + camera[5]);
  place[0] = (local[0] + camera[3]) / depth;
  place[1] = (local[1] + camera[4]) / depth;
}

template <int N>
struct Residual;

template <>
struct Residual<9> {
  double u, v;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* residual) const {
    T p[2];
    on_plane(camera, point, -1.0, p);
    const T r2 = p[0] * p[0] + p[1] * p[1];
    const T scale = camera[6] * (1.0 + r2 * (camera[7] + r2 * camera[8]));
    residual[0] = scale * p[0] - u;
    residual[1] = scale * p[1] - v;
    return true;
  }
};

template <>
struct Residual<11> {
  double u, v;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* residual) const {
    T p[2];
    on_plane(camera, point, 1.0, p);
    const T r2 = p[0] * p[0] + p[1] * p[1];
    const T scale = camera[6] * (1.0 + r2 * (camera[9] + r2 * camera[10]));
    residual[0] = scale * p[0] + camera[7] - u;
    residual[1] = scale * p[1] + camera[8] - v;
    return true;
  }
};

template <>
struct Residual<15> {
  double u, v;
  template <typename T>
  bool operator()(const T* camera, const T* point, T* residual) const {
    T p[2];
    on_plane(camera, point, 1.0, p);
    const T &k1 = camera[10], &k2 = camera[11], &p1 = camera[12], &p2 = camera[13], &k3 = camera[14];
    const T r2 = p[0] * p[0] + p[1] * p[1];
    const T radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    const T across = 2.0 * p[0] * p[1];
    residual[0] = camera[6] * (p[0] * radial + p1 * across + p2 * (r2 + 2.0 * p[0] * p[0])) + camera[8] - u;
    residual[1] = camera[7] * (p[1] * radial + p1 * (r2 + 2.0 * p[1] * p[1]) + p2 * across) + camera[9] - v;
    return true;
  }
};

template <int N>
void add_residuals(Observations& all, ceres::Problem& problem) {
  for (int64_t i = 0; i < all.count; ++i) {
    auto* residual = new Residual<N>{all.pixels[2 * i], all.pixels[2 * i + 1]};
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Residual<N>, 2, N, 3>(residual), nullptr,
                             &all.camera[N * all.camera_of[i]], &all.point[3 * all.point_of[i]]);
  }
}

void add_residuals(Observations& all, ceres::Problem& problem) {
  switch (all.parameters) {
    case 9: return add_residuals<9>(all, problem);
    case 11: return add_residuals<11>(all, problem);
    case 15: return add_residuals<15>(all, problem);
    default: throw std::runtime_error("a camera has 9, 11 or 15 parameters");
  }
}

ceres::Solver::Options options_for(const std::string& method, double tolerance, int threads) {
  ceres::Solver::Options options;
  options.linear_solver_type = method == "dense" ? ceres::DENSE_SCHUR : ceres::SPARSE_SCHUR;
  options.function_tolerance = tolerance;
  options.gradient_tolerance = 1e-30;
  options.parameter_tolerance = 1e-30;
  options.max_num_iterations = 200;
  options.num_threads = threads;
  options.logging_type = ceres::SILENT;
  return options;
}

void eliminate_points_first(Observations& all, ceres::Problem& problem, ceres::Solver::Options& options) {
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (int64_t i = 0; i < all.points; ++i)
    if (problem.HasParameterBlock(&all.point[3 * i])) ordering->AddElementToGroup(&all.point[3 * i], 0);
  for (int64_t i = 0; i < all.cameras; ++i)
    if (problem.HasParameterBlock(&all.camera[all.parameters * i]))
      ordering->AddElementToGroup(&all.camera[all.parameters * i], 1);
  options.linear_solver_ordering.reset(ordering);
}

void run(const std::string& path, const std::string& method, double tolerance, int threads) {
  const auto start = Clock::now();
  Observations all = read(path);
  ceres::Problem problem;
  add_residuals(all, problem);
  auto options = options_for(method, tolerance, threads);
  eliminate_points_first(all, problem, options);
  const auto solve_start = Clock::now();
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const double solve_s = seconds_since(solve_start);
  std::printf(
      "{\"initial_cost\": %.17g, \"cost\": %.17g, \"iterations\": %d, \"converged\": %s, \"solve_s\": %.6f, "
      "\"minimizer_s\": %.6f, \"total_s\": %.6f, \"threads\": %d, \"peak_mb\": %.1f}\n",
      summary.initial_cost, summary.final_cost, static_cast<int>(summary.iterations.size()) - 1,
      summary.termination_type == ceres::CONVERGENCE ? "true" : "false", solve_s, summary.minimizer_time_in_seconds,
      seconds_since(start), summary.num_threads_used, peak_mb());
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) {
    std::fprintf(stderr, "usage: ba PROBLEM dense|sparse TOLERANCE THREADS\n");
    return 2;
  }
  try {
    run(argv[1], argv[2], std::atof(argv[3]), std::atoi(argv[4]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ba: %s\n", error.what());
    return 1;
  }
  return 0;
}
