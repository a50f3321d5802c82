#include "apps/planar/page.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <stdexcept>
#include <string_view>
#include <vector>

#include "dfr/sim/planar/corridor.h"
#include "dfr/sim/planar/disc_push.h"
#include "page.css.h"
#include "page.html.h"
#include "page.js.h"

namespace dfr::apps::planar {
namespace {

using nlohmann::json;

// The page with each @NAME@ replaced by its text, which is not searched in turn.
std::string FillIn(std::string_view page, const std::map<std::string_view, std::string>& texts) {
  std::string filled;
  for (bool name = false; !page.empty(); name = !name) {
    const std::string_view part = page.substr(0, page.find('@'));
    filled += name ? texts.at(part) : part;
    page.remove_prefix(std::min(page.size(), part.size() + 1));
  }
  return filled;
}

// Five decimals are more than a picture can show, and keep the page small.
double Short(double value) { return std::round(1e5 * value) / 1e5; }

json Point(double x, double y) { return {Short(x), Short(y)}; }

json Vector(std::span<const double> values) {
  json list = json::array();
  for (const double value : values) list.push_back(Short(value));
  return list;
}

// One estimate as l(x) = log sum_k exp(w_k - gamma |A x + b - y_k|^2) - log rho.
json Estimate(const kernel::OneClassSvm& svm, const core::Matrix& a, const Eigen::VectorXd& b) {
  json rows = json::array();
  for (Eigen::Index i = 0; i < a.rows(); ++i) rows.push_back(Vector(core::Row(a, i)));
  json points = json::array();
  for (Eigen::Index k = 0; k < svm.support_vectors().rows(); ++k) {
    points.push_back(Vector(core::Row(svm.support_vectors(), k)));
  }
  const Eigen::VectorXd log_alpha = svm.alpha().array().log();
  return {{"A", std::move(rows)},   {"b", Vector(core::AsSpan(b))},
          {"y", std::move(points)}, {"w", Vector(core::AsSpan(log_alpha))},
          {"gamma", svm.gamma()},   {"logRho", std::log(svm.rho())}};
}

json Estimate(const Methods& methods, SupportKind kind, int t) {
  if (kind == SupportKind::kRaw) {
    const kernel::OneClassSvm& svm = methods.raw_support().at(t);
    const int n = svm.state_dim();
    return Estimate(svm, core::Matrix::Identity(n, n), Eigen::VectorXd::Zero(n));
  }
  const core::FeatureTransform& features = methods.recovery(kind).features();
  const kernel::WhitenedSupport& support = methods.recovery(kind).support();
  const std::vector<double> zero(static_cast<std::size_t>(features.state_dim()));
  Eigen::VectorXd origin(features.num_features());
  features.Apply(zero, core::AsSpan(origin));
  const core::Matrix a = support.map(t) * features.scale();
  const Eigen::VectorXd b = support.map(t) * origin;
  return Estimate(support.estimate(t), a, b);
}

const char* Key(SupportKind kind) {
  return kind == SupportKind::kRaw ? "raw" : kind == SupportKind::kGuided ? "guided" : "certified";
}

// Which shots to show: all of the learned policy's, and of a recovery ever fewer.
std::vector<std::size_t> Chosen(const Episode& episode) {
  std::vector<std::size_t> chosen;
  std::size_t run = 0;
  std::size_t next = 0;
  for (std::size_t i = 0; i < episode.shots.size(); ++i) {
    const control::Mode mode = episode.shots[i].step.mode;
    const bool recovering = mode == control::Mode::kRecovery || mode == control::Mode::kProbe;
    run = recovering ? run + 1 : 0;
    if (run <= 1) next = 1;
    if (recovering && run < next) continue;
    next = std::max(run + 1, run * 5 / 4);
    chosen.push_back(i);
  }
  return chosen;
}

json Frames(const Task& task, const Methods& methods, const Episode& episode, SupportKind kind) {
  json frames = json::array();
  for (const std::size_t i : Chosen(episode)) {
    const Shot& shot = episode.shots[i];
    frames.push_back({{"n", i},
                      {"x", Vector(shot.x)},
                      {"t", shot.step.t},
                      {"l", Short(methods.Level(kind, shot.step.t, shot.x))},
                      {"mode", control::Name(shot.step.mode)},
                      {"filtered", shot.step.filtered},
                      {"reach", shot.u.empty() ? 0.0 : Short(Reach(task, shot.u))}});
  }
  return frames;
}

json Scene(const Task& task, json& data) {
  const View view = ViewOf(task);
  data["view"] = {
      {"left", view.left}, {"right", view.right}, {"bottom", view.bottom}, {"top", view.top}};
  json red = {{"polygons", json::array()}, {"circles", json::array()}};
  if (const auto* corridor = dynamic_cast<const sim::CorridorPlant*>(task.plant.get())) {
    // Beyond the edges of the picture, which cuts it off there.
    constexpr double kBeyond = 0.5;
    const double left = view.left - kBeyond;
    const double right = view.right + kBeyond;
    for (const double side : {1.0, -1.0}) {
      const double edge = side * (view.top + kBeyond);
      json wall = {Point(left, edge)};
      for (const auto& [x, y] : corridor->Wall(side, left, right)) wall.push_back(Point(x, y));
      wall.push_back(Point(right, edge));
      red["polygons"].push_back(std::move(wall));
    }
    const double goal = corridor->options().length;
    data["goal"]["line"] = {Point(goal, view.bottom), Point(goal, view.top)};
  } else {
    const auto& o = dynamic_cast<const sim::DiscPushPlant&>(*task.plant).options();
    for (const double side : {1.0, -1.0}) {
      red["circles"].push_back({o.gate_x, side * o.gate_y, o.red_radius});
    }
    data["goal"]["circle"] = {o.goal_x, 0.0, o.goal_radius};
    data["disc"] = {{"object", o.object_radius}, {"pusher", o.pusher_radius}};
  }
  return red;
}

}  // namespace

void WritePage(const Task& task, const Methods& methods, const std::vector<Episode>& episodes,
               const std::filesystem::path& path) {
  json data;
  data["red"] = Scene(task, data);
  for (const core::Trajectory& d : methods.demonstrations()) {
    const Eigen::Index first = d.states.cols() - 2;
    json way = json::array();
    for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
      way.push_back(Point(d.states(t, first), d.states(t, first + 1)));
    }
    data["demonstrations"].push_back(std::move(way));
  }
  std::set<std::pair<SupportKind, int>> needed;
  for (const Episode& episode : episodes) {
    const SupportKind kind = SupportOf(episode.method);
    for (const std::size_t i : Chosen(episode)) needed.emplace(kind, episode.shots[i].step.t);
    data["methods"].push_back({{"name", episode.method},
                               {"support", Key(kind)},
                               {"outcome", std::string(core::Name(episode.outcome)) +
                                               (episode.cause.empty() ? "" : ", " + episode.cause)},
                               {"frames", Frames(task, methods, episode, kind)}});
  }
  for (const auto& [kind, t] : needed) {
    data["supports"][Key(kind)][std::to_string(t)] = Estimate(methods, kind, t);
  }

  std::ofstream page(path);
  page << FillIn(embedded::kPageHtml, {{"TITLE", "Recovery in the plane: " + task.name},
                                       {"CSS", std::string(embedded::kPageCss)},
                                       {"DATA", data.dump()},
                                       {"JS", std::string(embedded::kPageJs)}});
  page.close();
  if (!page) throw std::runtime_error(path.string() + ": the page cannot be written");
}

}  // namespace dfr::apps::planar
