#include "apps/planar_page/exports.h"

#include <algorithm>
#include <exception>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "apps/planar_page/world.h"
#include "dfr/core/contract.h"

using dfr::apps::planar_page::Disc;
using dfr::apps::planar_page::Episode;
using dfr::apps::planar_page::MethodNames;
using dfr::apps::planar_page::Point;
using dfr::apps::planar_page::PointPlant;
using dfr::apps::planar_page::SafeRegion;
using dfr::apps::planar_page::Scene;
using dfr::apps::planar_page::Scenes;
using dfr::apps::planar_page::Support;
using dfr::apps::planar_page::SupportOf;
using dfr::apps::planar_page::Tally;
using dfr::apps::planar_page::World;

namespace {

// Range of x of the walls, beyond both edges of the picture.
constexpr double kLeft = -1.0;
constexpr double kRight = 5.0;

struct State {
  std::optional<World> world;
  std::optional<Episode> episode;
  std::vector<double> array = std::vector<double>(64);
  std::string text;
  std::string error;
};

State& Page() {
  static State state;
  return state;
}

World& TheWorld() {
  DFR_THROW_UNLESS(Page().world.has_value(), "no scene is open");
  return *Page().world;
}

World& Fitted() {
  DFR_THROW_UNLESS(TheWorld().fitted(), "nothing is fitted yet");
  return TheWorld();
}

Episode& TheEpisode() {
  DFR_THROW_UNLESS(Page().episode.has_value(), "no episode has begun");
  return *Page().episode;
}

template <typename Function>
int Guarded(const Function& function) {
  try {
    return function();
  } catch (const std::exception& e) {
    Page().error = e.what();
    return -1;
  }
}

std::size_t Method(int index) {
  DFR_THROW_UNLESS(index >= 0 && index < static_cast<int>(MethodNames().size()),
                   "there is no method " << index);
  return static_cast<std::size_t>(index);
}

Support SupportAt(int index) {
  DFR_THROW_UNLESS(index >= 0 && index <= 2, "there is no support " << index);
  return static_cast<Support>(index);
}

// Fits the parts of the certified method if `support` needs them.
World& Fitted(Support support) {
  World& world = Fitted();
  if (support == Support::kCertified) world.FitCertified();
  return world;
}

World& FittedFor(int method) { return Fitted(SupportOf(Method(method))); }

void Write(std::initializer_list<double> values) {
  std::copy(values.begin(), values.end(), page_array(static_cast<int>(values.size())));
}

int WritePoints(const std::vector<Point>& points, double last) {
  double* out = page_array(static_cast<int>(2 * points.size() + 1));
  for (const Point& p : points) {
    *out++ = p[0];
    *out++ = p[1];
  }
  *out = last;
  return static_cast<int>(points.size());
}

double OutcomeOf(const Episode& episode) {
  return episode.over() ? static_cast<double>(episode.outcome()) : -1.0;
}

void Append(std::ostream& out, const std::vector<Point>& points) {
  out << '[';
  for (std::size_t i = 0; i < points.size(); ++i) {
    out << (i == 0 ? "" : ",") << '[' << points[i][0] << ',' << points[i][1] << ']';
  }
  out << ']';
}

void Append(std::ostream& out, const Disc& disc) {
  out << '[' << disc.centre[0] << ',' << disc.centre[1] << ',' << disc.radius << ']';
}

void Append(std::ostream& out, const Scene& scene) {
  out << "{\"name\":\"" << scene.name << "\",\"summary\":\"" << scene.summary << "\",\"start\":";
  Append(out, scene.start);
  out << ",\"goal\":";
  Append(out, scene.goal);
  out << ",\"routes\":" << scene.routes.size() << ",\"discs\":[";
  for (std::size_t i = 0; i < scene.discs.size(); ++i) {
    if (i > 0) out << ',';
    Append(out, scene.discs[i]);
  }
  out << "],\"boxes\":[";
  for (std::size_t i = 0; i < scene.boxes.size(); ++i) {
    if (i > 0) out << ',';
    Append(out, {scene.boxes[i].low, scene.boxes[i].high});
  }
  out << "],\"walls\":[";
  const PointPlant plant(scene);
  for (const double side : {1.0, -1.0}) {
    if (side < 0.0) out << ',';
    Append(out, plant.Wall(side, kLeft, kRight));
  }
  out << "]}";
}

}  // namespace

const char* page_describe() {
  std::ostringstream out;
  out.precision(17);
  out << "{\"gain\":" << PointPlant::kGain << ",\"methods\":[";
  for (std::size_t m = 0; m < MethodNames().size(); ++m) {
    out << (m == 0 ? "" : ",") << "{\"name\":\"" << MethodNames()[m]
        << "\",\"support\":" << static_cast<int>(dfr::apps::planar_page::SupportOf(m)) << '}';
  }
  out << "],\"causes\":[";
  for (int cause = 0; cause < dfr::control::kNumHaltCauses; ++cause) {
    out << (cause == 0 ? "" : ",") << '"' << Name(static_cast<dfr::control::HaltCause>(cause))
        << '"';
  }
  out << "],\"scenes\":[";
  for (std::size_t i = 0; i < Scenes().size(); ++i) {
    if (i > 0) out << ',';
    Append(out, Scenes()[i]);
  }
  out << "]}";
  Page().text = out.str();
  return Page().text.c_str();
}

const char* page_error() { return Page().error.c_str(); }

double* page_array(int count) {
  std::vector<double>& array = Page().array;
  if (count > static_cast<int>(array.size())) array.resize(static_cast<std::size_t>(count));
  return array.data();
}

int page_open(int scene) {
  return Guarded([&] {
    DFR_THROW_UNLESS(scene >= 0 && scene < static_cast<int>(Scenes().size()),
                     "there is no scene " << scene);
    Page().episode.reset();
    Page().world.emplace(static_cast<std::size_t>(scene));
    return 0;
  });
}

int page_demonstrate(int count, int seed) {
  return Guarded([&] {
    Page().episode.reset();
    TheWorld().Demonstrate(count, static_cast<std::uint64_t>(seed));
    return static_cast<int>(TheWorld().demonstrations().size());
  });
}

int page_draw(int points, int repeats, int seed) {
  return Guarded([&] {
    const double* in = page_array(2 * points);
    std::vector<Point> line(static_cast<std::size_t>(std::max(0, points)));
    for (Point& p : line) {
      p = {in[0], in[1]};
      in += 2;
    }
    TheWorld().Draw(line, repeats, static_cast<std::uint64_t>(seed));
    Page().episode.reset();
    return static_cast<int>(TheWorld().demonstrations().size());
  });
}

int page_clear() {
  return Guarded([&] {
    Page().episode.reset();
    TheWorld().Clear();
    return 0;
  });
}

int page_demonstration(int index) {
  return Guarded([&] {
    const auto& demonstrations = TheWorld().demonstrations();
    DFR_THROW_UNLESS(index >= 0 && index < static_cast<int>(demonstrations.size()),
                     "there is no demonstration " << index);
    const dfr::core::Matrix& states = demonstrations[static_cast<std::size_t>(index)].states;
    std::copy_n(states.data(), states.size(), page_array(static_cast<int>(states.size())));
    return static_cast<int>(states.rows());
  });
}

int page_fit() {
  return Guarded([&] {
    Page().episode.reset();
    TheWorld().Fit();
    return 0;
  });
}

int page_fit_certified() {
  return Guarded([&] {
    Fitted().FitCertified();
    return 0;
  });
}

int page_num_steps(int support) {
  return Guarded([&] { return Fitted(SupportAt(support)).num_steps(SupportAt(support)); });
}

int page_levels(int support, int t, double left, double top, double spacing, int columns,
                int rows) {
  return Guarded([&] {
    const Support of = SupportAt(support);
    const World& world = Fitted(of);
    double* out = page_array(columns * rows);
    for (int r = 0; r < rows; ++r) {
      for (int c = 0; c < columns; ++c) {
        *out++ = world.LogDecision(of, t, {left + c * spacing, top - r * spacing});
      }
    }
    return columns * rows;
  });
}

int page_look(int support, int t, double x, double y) {
  return Guarded([&] {
    const Support of = SupportAt(support);
    const World& world = Fitted(of);
    constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
    const SafeRegion region = world.fitted_certified() ? world.Certified(t, {x, y})
                                                       : SafeRegion{{kUnknown, kUnknown}, kUnknown};
    Write({world.LogDecision(of, t, {x, y}), world.Decision(of, t, {x, y}), region.centre[0],
           region.centre[1], region.radius});
    return 0;
  });
}

int page_nearest_step(int support, double x, double y) {
  return Guarded([&] {
    return Fitted(SupportAt(support)).NearestStep(SupportAt(support), {x, y});
  });
}

int page_start(int method, double x, double y, int first_step, int seed) {
  return Guarded([&] {
    Page().episode.emplace(FittedFor(method).Start(Method(method), {x, y}, first_step,
                                                   static_cast<std::uint64_t>(seed)));
    return 0;
  });
}

int page_start_state(int seed) {
  return Guarded([&] {
    PointPlant plant(TheWorld().scene());
    plant.Reset(static_cast<std::uint64_t>(seed));
    Write({plant.point()[0], plant.point()[1]});
    return 0;
  });
}

int page_step() {
  return Guarded([&] {
    Episode& episode = TheEpisode();
    const auto d = episode.Step();
    Write({d.from[0], d.from[1], d.to[0], d.to[1], d.wanted[0], d.wanted[1],
           static_cast<double>(d.step.mode), static_cast<double>(d.step.t), d.step.g,
           d.step.threshold, d.step.filtered ? 1.0 : 0.0, d.step.certified ? 1.0 : 0.0,
           OutcomeOf(episode), static_cast<double>(episode.cause())});
    return 0;
  });
}

int page_displace(double x, double y) {
  return Guarded([&] {
    TheEpisode().plant().MoveTo({x, y});
    return 0;
  });
}

int page_push(double dx, double dy) {
  return Guarded([&] {
    Fitted().Push({dx, dy});
    return 0;
  });
}

int page_preview(int method, double x, double y, int first_step, int most) {
  return Guarded([&] {
    Episode episode = FittedFor(method).Start(Method(method), {x, y}, first_step, 0);
    std::vector<Point> way = {{x, y}};
    way.reserve(static_cast<std::size_t>(most) + 1);
    for (int i = 0; i < most && !episode.over(); ++i) way.push_back(episode.Step().to);
    return WritePoints(way, OutcomeOf(episode));
  });
}

int page_run(int method, int count, int seed) {
  return Guarded([&] {
    const Tally tally =
        FittedFor(method).Run(Method(method), count, static_cast<std::uint64_t>(seed));
    Write({static_cast<double>(tally.completed), static_cast<double>(tally.halted),
           static_cast<double>(tally.collided)});
    return 0;
  });
}
