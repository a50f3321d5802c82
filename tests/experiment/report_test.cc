#include "dfr/experiment/report.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::experiment {
namespace {

using testing::HasSubstr;
using testing::Not;

Summary MakeSummary() {
  const EvaluationPlan plan = test::FakePlan();
  return Summarize(plan, Evaluate(plan, test::MakeFakeTrialRunner),
                   {.experiment = "pusher", .preset = "quick", .commit = "0123abc"});
}

int Count(const std::string& text, const std::string& part) {
  int count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) {
    ++count;
  }
  return count;
}

// Checks that elements nest as in XML. Ignores HTML's void elements and the doctype.
void ExpectNested(const std::string& html) {
  std::vector<std::string> open;
  for (std::size_t at = html.find('<'); at != std::string::npos; at = html.find('<', at + 1)) {
    const std::size_t end = html.find('>', at);
    ASSERT_NE(end, std::string::npos);
    const bool closing = html[at + 1] == '/';
    std::string name;
    for (std::size_t i = at + (closing ? 2 : 1); std::isalnum(static_cast<unsigned char>(html[i]));
         ++i) {
      name += html[i];
    }
    if (name.empty() || name == "meta" || name == "br" || name == "img" || html[end - 1] == '/') {
      continue;
    }
    if (!closing) {
      open.push_back(name);
      continue;
    }
    ASSERT_FALSE(open.empty()) << "</" << name << "> closes nothing";
    ASSERT_EQ(open.back(), name) << html.substr(at > 200 ? at - 200 : 0, 220);
    open.pop_back();
  }
  EXPECT_TRUE(open.empty());
}

TEST(ReportTest, ShowsThePapersThreePanelsPerLearner) {
  const std::string html = RenderReport(MakeSummary(), {.title = "Pusher"});
  ExpectNested(html);
  for (const char* panel : {"Completed", "Halted", "Collided"}) {
    EXPECT_EQ(Count(html, std::string("aria-label=\"") + panel + "\""), 2) << panel;
  }
  // Two methods in each of 2 x 3 panels, with a band, a line and a marker per data point. Each row
  // of panels has a legend with the name and marker of both methods.
  EXPECT_EQ(Count(html, "class=\"band\""), 12);
  EXPECT_EQ(Count(html, "class=\"line\""), 12);
  EXPECT_EQ(Count(html, "class=\"mark\""), 24 + 4);
  EXPECT_EQ(Count(html, "class=\"name\""), 4);
  EXPECT_THAT(html, HasSubstr("<h1>Pusher</h1>"));
  EXPECT_THAT(html, HasSubstr("0123abc"));
  EXPECT_THAT(html, HasSubstr("halted: outside-support"));
}

TEST(ReportTest, NumbersAreThoseOfTheSummary) {
  Summary summary = MakeSummary();
  summary.contrasts[0].ratios.collision_reduction = 0.83;
  summary.contrasts[0].ratios.collision_reduction_interval = Interval{0.79, 0.87};
  summary.contrasts[0].ratios.completion_ratio = 0.65;
  summary.contrasts[0].controls_ratio = 11.54;
  summary.contrasts[1].ratios.collision_reduction = -0.12;
  summary.contrasts[1].ratios.completion_ratio = 6.09;
  summary.contrasts[1].ratios.completion_ratio_interval = Interval{4.19, 11.7};
  summary.averages[0].completed = {0.412, {0.3731, 0.4523}};
  summary.averages[0].passed = 0.9627;
  summary.averages[0].change = 0.415;
  const std::string html = RenderReport(summary, {});
  EXPECT_THAT(html, HasSubstr("<b>\u221283\u2009%</b>collisions<br>[\u221287, \u221279]"));
  EXPECT_THAT(html, HasSubstr("<b>65\u2009%</b>of its completions"));
  EXPECT_THAT(html, HasSubstr("<b>609\u2009%</b>of its completions<br>[419, 1170]"));
  EXPECT_THAT(html, HasSubstr("<b>11.5\u2009\u00d7</b>controls per trajectory"));
  EXPECT_THAT(html, HasSubstr("<b>+12\u2009%</b>collisions"));
  EXPECT_THAT(html, HasSubstr("41.2 <small>[37.3, 45.2]</small>"));
  EXPECT_THAT(html, HasSubstr("<td class=\"n\">96.3</td><td class=\"n\">0.4"));
}

TEST(ReportTest, NamesTheClusters) {
  Summary summary = MakeSummary();
  const auto caption = [&](const char* clusters) {
    summary.contrasts.front().clusters = clusters;
    const std::string html = RenderReport(summary, {.title = "Pusher"});
    const std::size_t begin = html.find("Fieller's 95 % intervals");
    return html.substr(begin, html.find("</p>", begin) - begin);
  };
  const std::string exact =
      " With fewer than 5 events of the method, or the same ratio in all clusters, they also cover "
      "the exact interval of the ratio of two rates.";
  EXPECT_EQ(caption("supervisors"), "Fieller's 95 % intervals, clustered by supervisor." + exact);
  EXPECT_EQ(caption("trials"), "Fieller's 95 % intervals, clustered by trial." + exact);
  EXPECT_THAT(caption("episodes"), testing::HasSubstr("too few trials to cluster by"));
}

// Returns a page of one plot with these lines.
std::string PageOf(const std::vector<ReportSeries>& series) {
  const ReportPlot plot{.title = "P", .x_label = "x", .series = series};
  return RenderReport({}, {.figures = {{.heading = "F", .caption = "C", .plots = {plot}}}});
}

TEST(ReportTest, APointHasItsIntervalAsABar) {
  ReportSeries point{.name = "guard", .x = {4.0}, .y = {0.9}};
  EXPECT_THAT(PageOf({point}), Not(HasSubstr("<line class=\"bar\"")));
  point.low = {0.8};
  point.high = {0.95};
  EXPECT_THAT(PageOf({point}), HasSubstr("<line class=\"bar\""));
}

TEST(ReportTest, AMethodLooksTheSameOnEveryPage) {
  // Each method has one style for its id and its name, independent of the other methods and their
  // order. No two methods share a style.
  std::set<int> styles;
  for (const NamedStyle& style : NamedStyles()) {
    EXPECT_EQ(MethodStyle(style.method), style.style);
    EXPECT_EQ(MethodStyle(style.name), style.style);
    styles.insert(style.style);
  }
  EXPECT_EQ(styles.size() + 1, NamedStyles().size());  // baseline and alone share a style
  EXPECT_EQ(MethodStyle("my-method"), -1);
  EXPECT_THAT(PageOf({{.name = "Controller", .x = {0, 1}, .y = {0, 1}}}),
              HasSubstr("<g style=\"--c:var(--s3)\"><path class=\"line\""));
  Summary summary = MakeSummary();
  for (Cell& cell : summary.averages)
    cell.method = cell.method == "baseline" ? "mine" : "controller";
  const std::string compared = RenderReport(summary, {});
  EXPECT_THAT(compared, HasSubstr("style=\"--c:var(--s3)\"></span>Controller"));
  EXPECT_THAT(compared, HasSubstr("style=\"--c:var(--s1)\"></span>mine"));
}

// A colour "#rrggbb" in Oklab (Ottosson 2020) and its relative luminance (WCAG 2).
struct SeenColour {
  std::array<double, 3> lab;
  double luminance;
};

SeenColour See(const std::string& hex) {
  std::array<double, 3> c{};
  for (std::size_t i = 0; i < 3; ++i) {
    const double value = std::stoi(hex.substr(1 + 2 * i, 2), nullptr, 16) / 255.0;
    c[i] = value <= 0.04045 ? value / 12.92 : std::pow((value + 0.055) / 1.055, 2.4);
  }
  const double l = std::cbrt(0.4122214708 * c[0] + 0.5363325363 * c[1] + 0.0514459929 * c[2]);
  const double m = std::cbrt(0.2119034982 * c[0] + 0.6806995451 * c[1] + 0.1073969566 * c[2]);
  const double s = std::cbrt(0.0883024619 * c[0] + 0.2817188376 * c[1] + 0.6299787005 * c[2]);
  return {{0.2104542553 * l + 0.7936177850 * m - 0.0040720468 * s,
           1.9779984951 * l - 2.4285922050 * m + 0.4505937099 * s,
           0.0259040371 * l + 0.7827717662 * m - 0.8086757660 * s},
          0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]};
}

double Distance(const SeenColour& a, const SeenColour& b) {
  return std::hypot(a.lab[0] - b.lab[0], a.lab[1] - b.lab[1], a.lab[2] - b.lab[2]);
}

TEST(ReportTest, NoTwoStylesLookTheSame) {
  EXPECT_NEAR(Distance(See("#000000"), See("#ffffff")), 1.0, 1e-6);
  const std::string page = RenderReport({}, {});
  const std::size_t dark = page.find("prefers-color-scheme: dark");
  ASSERT_NE(dark, std::string::npos);
  for (const std::size_t mode : {std::size_t{0}, dark}) {
    const auto colour_of = [&](const std::string& name) {
      return See(page.substr(page.find("--" + name + ": ", mode) + name.size() + 4, 7));
    };
    const double paper = colour_of("paper").luminance;
    std::map<std::string, SeenColour> seen;
    for (const NamedStyle& named : NamedStyles()) {
      const std::string html = PageOf({{.name = std::string(named.name), .x = {0}, .y = {0}}});
      const std::size_t begin = html.find("--c:var(--") + 10;
      const std::string variable = html.substr(begin, html.find(')', begin) - begin);
      if (seen.contains(variable)) {
        EXPECT_THAT(named.method, testing::AnyOf("baseline", "alone")) << variable;
        continue;
      }
      const SeenColour colour = colour_of(variable);
      const double contrast =
          (std::max(paper, colour.luminance) + 0.05) / (std::min(paper, colour.luminance) + 0.05);
      EXPECT_GE(contrast, 3.0) << named.name;  // WCAG 2 for graphics
      // Minimum distance: three times the just-noticeable difference of colours side by side.
      for (const auto& [other, theirs] : seen) {
        if (variable.front() != 's' || other.front() != 's') continue;  // outcomes are not methods
        EXPECT_GT(Distance(colour, theirs), 0.06) << named.name << " and " << other;
      }
      seen.emplace(variable, colour);
    }
  }
}

TEST(ReportTest, ALineWithoutAStyleTakesAFreeOne) {
  const std::string page = PageOf({{.name = "mine", .x = {0}, .y = {0}},
                                   {.name = "alone", .x = {0}, .y = {0}},
                                   {.name = "yours", .x = {0}, .y = {0}},
                                   {.name = "monitor", .x = {0}, .y = {0}}});
  const std::string key = page.substr(page.find("class=\"key\""));
  const auto style_of = [&](const std::string& name) {
    const std::size_t begin = key.rfind("style=\"", key.find("</svg>" + name)) + 7;
    return key.substr(begin, key.find('"', begin) - begin);
  };
  EXPECT_EQ(style_of("alone"), "--c:var(--s0)");
  EXPECT_EQ(style_of("mine"), "--c:var(--s1)");
  EXPECT_EQ(style_of("yours"), "--c:var(--s2)");
  EXPECT_EQ(style_of("monitor"), "--c:var(--s18);--dash:6 3;--dot:transparent");
}

TEST(ReportTest, BeginsWithAVerdict) {
  Summary summary = MakeSummary();
  for (Contrast& contrast : summary.contrasts) {
    contrast.ratios.collision_reduction = 0.8;
    contrast.ratios.collision_reduction_interval = Interval{0.7, 0.9};
    contrast.ratios.completion_ratio = 1.1;
    contrast.ratios.completion_ratio_interval = Interval{1.0, 1.2};
    contrast.clusters = "trials";
  }
  const auto verdict = [&] {
    const std::string html = RenderReport(summary, {});
    const std::size_t begin = html.find("</h1>");
    return html.substr(begin, html.find("</ul>", begin) - begin);
  };
  EXPECT_THAT(verdict(), HasSubstr("Fit for use"));
  ReportOptions unjudged;
  for (const Contrast& contrast : summary.contrasts) unjudged.unjudged.insert(contrast.method);
  EXPECT_THAT(RenderReport(summary, unjudged), Not(HasSubstr("Fit for use")));
  // The learner with the strongest evidence against a method decides.
  Contrast& last = summary.contrasts.back();
  last.clusters = "episodes";
  EXPECT_THAT(verdict(), HasSubstr("too few trials"));
  last.ratios.completion_ratio_interval->low = 0.89;
  EXPECT_THAT(verdict(), HasSubstr("Doubtful"));
  last.ratios.collision_reduction_interval->low = -0.01;
  EXPECT_THAT(verdict(), HasSubstr("fewer collisions are not shown"));
  last.ratios.completion_ratio = 0.49;
  EXPECT_THAT(verdict(), HasSubstr("Do not use"));
  last.ratios.collision_reduction_interval = Interval{-0.9, -0.1};
  EXPECT_THAT(verdict(), HasSubstr("it collides more often"));
  EXPECT_THAT(RenderReport({}, {.verdict = "Doubtful: few."}),
              HasSubstr("</h1>\n<p class=\"verdict\">Doubtful: few.</p>"));
}

TEST(ReportTest, AbsentValuesAreDashes) {
  Summary summary = MakeSummary();
  summary.contrasts[0].ratios = {};
  summary.contrasts[0].controls_ratio.reset();
  const std::string html = RenderReport(summary, {});
  EXPECT_THAT(html, HasSubstr("<b>\u2013</b>collisions"));
  EXPECT_THAT(html, Not(HasSubstr("nan")));
  EXPECT_THAT(html, Not(HasSubstr("inf,")));
}

TEST(ReportTest, IsSelfContained) {
  ReportOptions options;
  const std::filesystem::path folder = test::EmptyFolder("report");
  std::ofstream(folder / "scene.png", std::ios::binary) << "Man";
  std::ofstream(folder / "rollout.webm", std::ios::binary) << "Ma";
  options.media = {{folder / "scene.png", "The scene"}, {folder / "rollout.webm", "A rollout"}};
  const std::string html = RenderReport(MakeSummary(), options);
  ExpectNested(html);
  EXPECT_THAT(html, HasSubstr("src=\"data:image/png;base64,TWFu\""));
  EXPECT_THAT(html, HasSubstr("src=\"data:video/webm;base64,TWE=\""));
  for (const char* reference : {"http:", "https:", "//", "@import", "url(", "<script ", "<link"}) {
    EXPECT_THAT(html, Not(HasSubstr(reference)));
  }
  // Every reference is a data URI.
  EXPECT_EQ(Count(html, "src=\""), Count(html, "src=\"data:"));
  EXPECT_EQ(Count(html, "href="), 0);
}

TEST(ReportTest, EscapesEveryText) {
  const std::string evil = "<b>&\"'";
  Summary summary = MakeSummary();
  summary.experiment = summary.preset = summary.commit = evil;
  for (Cell& cell : summary.cells) {
    cell.method += evil;
    cell.learner += evil;
  }
  for (Cell& cell : summary.averages) {
    cell.method += evil;
    cell.learner += evil;
    cell.halt_causes = {{evil, 1}};
    cell.collision_causes = {{evil, 1}};
  }
  for (Contrast& contrast : summary.contrasts) {
    contrast.method += evil;
    contrast.learner += evil;
    contrast.against += evil;
  }
  for (MeasureMean& measure : summary.measures) measure.name = measure.learner = evil;
  ReportOptions options;
  options.title = options.introduction = evil;
  options.settings = {{evil, evil}};
  ReportPlot plot{.title = evil, .x_label = evil};
  plot.series.push_back({.name = evil, .x = {1, 2}, .y = {3, 4}});
  options.figures = {{evil, evil, {plot}}};
  options.tables = {{evil, evil, {evil}, {{evil}}}};
  options.notes = {{evil, evil}};
  const std::string html = RenderReport(summary, options);
  ExpectNested(html);
  EXPECT_EQ(Count(html, evil), 0);
  EXPECT_EQ(Count(html, "<b>&"), 0);
  EXPECT_GT(Count(html, "&lt;b&gt;&amp;&quot;&#39;"), 30);
}

TEST(ReportTest, TakesFurtherFiguresTablesNotesAndSettings) {
  ReportOptions options;
  options.method_names = {{"dfr", "Derivative-free"}};
  options.learner_names = {{"8", "of 8 tanh units"}};
  ReportPlot plot{.title = "Convergence", .x_label = "iterations"};
  plot.series.push_back({.name = "mean", .x = {0, 1, 2}, .y = {0.5, 0.75, 1.0}});
  const double nan = std::numeric_limits<double>::quiet_NaN();
  plot.series.push_back({.name = "gap", .x = {0, 1, 2}, .y = {0.5, nan, 1.0}});
  options.figures = {{"How recoveries climb", "Means of 50.", {plot}}};
  options.tables = {{"Beside the paper", "", {"figure", "paper"}, {{"collisions", "-83 %"}}}};
  options.notes = {{"Why", "First.\n\nSecond."}};
  options.settings = {{"gamma", "5"}};
  const std::string html = RenderReport(MakeSummary(), options);
  ExpectNested(html);
  EXPECT_THAT(html, HasSubstr("Derivative-free"));
  EXPECT_THAT(html, HasSubstr("<h3>Learner of 8 tanh units</h3>"));
  EXPECT_THAT(html, HasSubstr("aria-label=\"Convergence\""));
  EXPECT_THAT(html, HasSubstr("-83 %"));
  EXPECT_THAT(html, HasSubstr("<p>First.</p>\n<p>Second.</p>"));
  EXPECT_THAT(html, HasSubstr("<td>gamma</td><td class=\"text\"><code>5</code>"));
  EXPECT_LT(html.find("<h2>How recoveries climb"), html.find("<table"));
  EXPECT_LT(html.find("class=\"bars\""), html.find("<table"));
  EXPECT_THAT(html, Not(HasSubstr("nan")));
}

TEST(ReportTest, ALineWithoutANameHasNoneInTheLegend) {
  const std::string page =
      PageOf({{"", {0, 1}, {1, 2}}, {"named", {0, 1}, {2, 3}}, {"", {0, 1}, {3, 4}}});
  EXPECT_EQ(Count(page, "<path class=\"line\""), 3);
  EXPECT_EQ(Count(page, "<path class=\"stroke\""), 1);
  EXPECT_EQ(Count(page, "</svg>named</span>"), 1);
}

TEST(ReportTest, WithoutMethodsItShowsTheOptionsAlone) {
  const std::string page = RenderReport({}, {.title = "Guard", .introduction = "How far."});
  ExpectNested(page);
  EXPECT_THAT(page, HasSubstr("<h1>Guard</h1>"));
  EXPECT_THAT(page, HasSubstr("How far."));
  for (const char* part : {"All data points", "How episodes ended", "Every data point", "seed"}) {
    EXPECT_THAT(page, Not(HasSubstr(part)));
  }
}

TEST(ReportTest, APageIsSavedThroughALinkAndKeepsItsMode) {
  const dfr::test::TempFolder folder;
  const std::filesystem::path page = folder / "page.html";
  const std::filesystem::path link = folder / "link.html";
  const std::filesystem::path notes = folder / "link.html.part";
  std::ofstream(page) << "before";
  std::ofstream(notes) << "the user's";
  std::filesystem::permissions(
      page, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
  std::filesystem::create_symlink(page, link);
  SaveReport({}, {.title = "Guard"}, link);
  ASSERT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_GT(std::filesystem::file_size(page), 100U);
  EXPECT_EQ(dfr::test::FileText(notes), "the user's");
  EXPECT_EQ(std::filesystem::status(page).permissions(), std::filesystem::perms(0600));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path), {}), 3);
}

// Tests a pipe in place of a device, which only root can create.
TEST(ReportTest, APipeStaysAPipe) {
  const dfr::test::TempFolder folder;
  const std::filesystem::path pipe = folder / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  const int reader = open(pipe.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  ASSERT_GE(reader, 0);
  ASSERT_GE(fcntl(reader, F_SETPIPE_SZ, 1 << 18), 1 << 18);
  SaveReport({}, {.title = "Guard"}, pipe);
  std::array<char, 15> begin{};
  EXPECT_EQ(read(reader, begin.data(), begin.size()), 15);
  EXPECT_EQ(std::string(begin.data(), begin.size()), "<!DOCTYPE html>");
  close(reader);
  EXPECT_TRUE(std::filesystem::is_fifo(pipe));
}

TEST(ReportTest, ErrorsNameTheCulprit) {
  const Summary summary = MakeSummary();
  const auto message = [&](const ReportOptions& options) -> std::string {
    return dfr::test::MessageOf([&] { (void)RenderReport(summary, options); });
  };
  ReportOptions options;
  ReportPlot plot;
  plot.series.push_back({.name = "climb", .x = {1, 2}, .y = {3}});
  options.figures = {{"", "", {plot}}};
  EXPECT_THAT(message(options), HasSubstr("'climb'"));
  options = {};
  options.tables = {{"paper", "", {"a", "b"}, {{"1"}}}};
  EXPECT_THAT(message(options), HasSubstr("'paper'"));
  options = {};
  options.media = {{"scene.bmp", ""}};
  EXPECT_THAT(message(options), HasSubstr("scene.bmp"));
  options.media = {{"/no/such/scene.png", ""}};
  EXPECT_THAT(message(options), HasSubstr("/no/such/scene.png"));
}

}  // namespace
}  // namespace dfr::experiment
