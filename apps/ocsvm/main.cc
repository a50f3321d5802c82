// One-class SVMs from the command line, for those who know LIBSVM's svm-train and svm-predict.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "apps/command_line.h"
#include "dfr/core/atomic_file.h"
#include "dfr/core/format.h"
#include "dfr/experiment/report.h"
#include "dfr/kernel/libsvm_io.h"
#include "dfr/kernel/model_selection.h"
#include "dfr/kernel/one_class_svm.h"

namespace {

using dfr::core::Matrix;
using dfr::kernel::FitSummary;
using dfr::kernel::OneClassSvm;

volatile std::sig_atomic_t interrupted = 0;

// One line on a terminal, a few times a second: the gap falls to the tolerance on a log scale.
class ProgressLine {
 public:
  explicit ProgressLine(bool quiet) : shown_(!quiet && isatty(STDERR_FILENO) != 0) {}
  ~ProgressLine() { Clear(); }

  void Show(const dfr::kernel::FitProgress& p) {
    const auto now = std::chrono::steady_clock::now();
    if (!shown_ || now - last_ < std::chrono::milliseconds(200)) return;
    last_ = now;
    dirty_ = true;
    std::fprintf(stderr, "\r%lld iterations, largest violation %.2e, to reach %.0e%s   ",
                 static_cast<long long>(p.iterations), p.kkt_gap, p.tolerance,
                 Left(p, now).c_str());
  }
  void Clear() {
    if (dirty_) std::fprintf(stderr, "\r%90s\r", "");
    dirty_ = false;
  }

 private:
  using Clock = std::chrono::steady_clock;

  // ", about 12 s left": the logarithm of the violation falls at about the same rate throughout.
  std::string Left(const dfr::kernel::FitProgress& p, Clock::time_point now) {
    if (first_gap_ == 0.0) {
      first_ = now;
      first_gap_ = p.kkt_gap;
    }
    const double fallen = std::log(first_gap_ / p.kkt_gap);
    const double to_fall = std::log(p.kkt_gap / p.tolerance);
    if (!(fallen > 0.0) || !(to_fall > 0.0)) return "";
    const double spent = std::chrono::duration<double>(now - first_).count();
    return dfr::core::Format(", about %.0f s left", std::ceil(spent * to_fall / fallen));
  }

  bool shown_;
  bool dirty_ = false;
  Clock::time_point last_;
  Clock::time_point first_;
  double first_gap_ = 0.0;
};

struct TrainOptions {
  double nu = 0.5;
  double gamma = 0.0;
  double tolerance = 1e-3;
  double memory_mib = 512.0;
  int threads = 0;
  bool quiet = false;
  std::string data;
  std::string model;
};

int Train(const TrainOptions& o) {
  const Matrix samples = dfr::kernel::LoadSamples(o.data);
  dfr::kernel::OneClassSvmOptions options{
      .nu = o.nu,
      .gamma = o.gamma > 0.0 ? o.gamma : 1.0 / static_cast<double>(samples.cols()),
      .tolerance = o.tolerance,
      .memory_mib = o.memory_mib,
      .threads = o.threads};
  ProgressLine line(o.quiet);
  options.progress = [&](const dfr::kernel::FitProgress& p) {
    line.Show(p);
    return interrupted == 0;
  };
  FitSummary summary;
  const auto svm = OneClassSvm::Fit(samples, options, &summary);
  line.Clear();
  dfr::kernel::SaveLibsvmModel(svm, o.model);
  if (!o.quiet) {
    std::printf("samples          %ld x %ld\n", static_cast<long>(samples.rows()),
                static_cast<long>(samples.cols()));
    std::printf("support vectors  %d\n", svm.num_support_vectors());
    std::printf("objective        %.10g\n", summary.objective);
    std::printf("rho              %.10g\n", svm.rho() * svm.libsvm_scale());
    std::printf("KKT gap          %.3g\n", summary.kkt_gap);
    std::printf("iterations       %lld\n", static_cast<long long>(summary.iterations));
    std::printf("kernel values    %.4g million\n",
                static_cast<double>(summary.kernel_evaluations) * 1e-6);
    std::printf("time             %.3g s\n", summary.seconds);
  }
  if (summary.reason == FitSummary::Reason::kConverged) return EXIT_SUCCESS;
  const bool by_user = summary.reason == FitSummary::Reason::kInterrupted;
  if (std::isfinite(summary.kkt_gap)) {
    std::fprintf(
        stderr,
        "ocsvm: %s at a KKT gap of %.3g, above the tolerance of %.3g; the model is written "
        "as it stands\n",
        by_user ? "interrupted" : "stopped", summary.kkt_gap, o.tolerance);
  } else {
    std::fprintf(stderr,
                 "ocsvm: interrupted before all samples were looked at; the model is written as it "
                 "stands, which is a guess\n");
  }
  constexpr int kInterrupted = 130;  // as shells report Ctrl-C
  return by_user ? kInterrupted : EXIT_FAILURE;
}

// LIBSVM leaves zeros out: a model may be narrower than its data.
OneClassSvm Widened(const OneClassSvm& svm, Eigen::Index width) {
  if (width <= svm.state_dim()) return svm;
  Matrix wide = Matrix::Zero(svm.num_support_vectors(), width);
  wide.leftCols(svm.state_dim()) = svm.support_vectors();
  return OneClassSvm::FromParts(std::move(wide), svm.alpha(), svm.gamma(), svm.rho(),
                                svm.libsvm_scale());
}

struct PredictOptions {
  bool decision_values = false;
  std::string data;
  std::string model;
  std::string out;
};

int Predict(const PredictOptions& o) {
  const OneClassSvm model = dfr::kernel::LoadLibsvmModel(o.model);
  Matrix states = dfr::kernel::LoadSamples(o.data);
  if (states.cols() < model.state_dim())
    states = dfr::kernel::LoadSamples(o.data, model.state_dim());
  const OneClassSvm svm = Widened(model, states.cols());
  std::vector<double> g(static_cast<std::size_t>(states.rows()));
  svm.DecisionBatch(states, g, 0);
  std::ostringstream out;
  out.precision(17);
  std::size_t inside = 0;
  for (const double value : g) {
    inside += value > 0.0 ? 1 : 0;
    if (o.decision_values) {
      out << value * svm.libsvm_scale() << '\n';
    } else {
      out << (value > 0.0 ? 1 : -1) << '\n';
    }
  }
  dfr::core::ReplaceFile(o.out, out.view());
  std::printf("%zu of %zu inside (%.4g %%)\n", inside, g.size(),
              100.0 * static_cast<double>(inside) / static_cast<double>(g.size()));
  return EXIT_SUCCESS;
}

struct TuneOptions {
  std::vector<double> nus = {0.05, 0.1};
  std::vector<double> gammas;
  int length = 1;
  int folds = 4;
  int threads = 0;
  double acceptance = 0.9;
  std::string data;
  std::string picture;
};

// Held-out states inside (full) and volume (dashed) over gamma, one colour for each nu.
dfr::experiment::ReportPlot Comparison(const dfr::kernel::Selection& selection) {
  dfr::experiment::ReportPlot plot{.title = "Held out: inside (full), volume (dashed)",
                                   .x_label = "gamma",
                                   .percent = true,
                                   .log_x = true,
                                   .y_min = 0.0,
                                   .y_max = 1.0};
  int style = 1;
  for (auto row = selection.rows.begin(); row != selection.rows.end(); ++style) {
    dfr::experiment::ReportSeries inside{
        .name = dfr::core::Format("nu = %g", row->nu), .x = {}, .y = {}, .style = style};
    dfr::experiment::ReportSeries volume{
        .name = "volume", .x = {}, .y = {}, .style = style, .dashed = true};
    for (const double nu = row->nu; row != selection.rows.end() && row->nu == nu; ++row) {
      inside.x.push_back(row->gamma);
      inside.y.push_back(row->acceptance);
      volume.x.push_back(row->gamma);
      volume.y.push_back(row->volume);
    }
    plot.series.insert(plot.series.end(), {std::move(inside), std::move(volume)});
  }
  const auto& best = selection.rows[selection.chosen];
  plot.series.push_back({.name = "chosen", .x = {best.gamma}, .y = {best.acceptance}, .style = 0});
  return plot;
}

int Tune(const TuneOptions& o) {
  const Matrix samples = dfr::kernel::LoadSamples(o.data);
  if (samples.rows() % o.length != 0) {
    throw std::runtime_error(o.data + ": " + std::to_string(samples.rows()) +
                             " samples are no whole number of demonstrations of " +
                             std::to_string(o.length));
  }
  std::vector<Matrix> demonstrations;
  for (Eigen::Index i = 0; i < samples.rows(); i += o.length) {
    demonstrations.push_back(samples.middleRows(i, o.length));
  }
  dfr::kernel::SelectionOptions options;
  options.nus = o.nus;
  options.gammas = o.gammas;
  for (int exponent = -4; o.gammas.empty() && exponent <= 4; ++exponent) {
    options.gammas.push_back(std::ldexp(1.0, exponent) / static_cast<double>(samples.cols()));
  }
  options.folds = o.folds;
  options.acceptance = o.acceptance;
  options.support.pooled = true;
  options.support.threads = o.threads;
  options.support.svm.tolerance = 1e-3;
  options.support.svm.progress = [](const dfr::kernel::FitProgress&) { return interrupted == 0; };
  const dfr::kernel::Selection selection = dfr::kernel::SelectModel(demonstrations, options);
  if (interrupted != 0) throw std::runtime_error("interrupted");
  std::cout << selection.Table();
  const auto& best = selection.rows[selection.chosen];
  std::printf("%s: ocsvm train -n %g -g %g %s MODEL\n",
              selection.accepted ? "Least volume of those that accept enough"
                                 : "None accepts enough; the one that accepts most",
              best.nu, best.gamma, o.data.c_str());
  if (!o.picture.empty()) dfr::experiment::SavePlot(Comparison(selection), o.picture);
  return EXIT_SUCCESS;
}

CLI::App* AddTrain(CLI::App& app, TrainOptions& o) {
  CLI::App* command = app.add_subcommand("train", "Fits a model to DATA");
  command->add_option("-n,--nu", o.nu, "share of outliers at most, (0, 1]")->capture_default_str();
  command
      ->add_option("-g,--gamma", o.gamma,
                   "width of the kernel exp(-gamma |x - y|^2); default: 1 / features")
      ->check(dfr::apps::kPositive);
  command->add_option("-e,--tolerance", o.tolerance, "stop at this KKT violation")
      ->capture_default_str();
  command->add_option("-m,--memory", o.memory_mib, "memory of the fit, in MiB")
      ->capture_default_str();
  command->add_option("--threads", o.threads, "0: one per core; the results are the same")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  command->add_flag("-q,--quiet", o.quiet, "print errors only");
  command->add_option("DATA", o.data)->required();
  command->add_option("MODEL", o.model)->required();
  return command;
}

CLI::App* AddPredict(CLI::App& app, PredictOptions& o) {
  CLI::App* command =
      app.add_subcommand("predict", "Writes 1 (inside) or -1 for each sample of DATA to OUT");
  command->add_flag("--decision-values", o.decision_values,
                    "write LIBSVM's decision values instead");
  command->add_option("DATA", o.data)->required();
  command->add_option("MODEL", o.model)->required();
  command->add_option("OUT", o.out)->required();
  return command;
}

void AddTune(CLI::App& app, TuneOptions& o) {
  CLI::App* command = app.add_subcommand(
      "tune", "Compares nu and gamma on held-out parts of DATA and prints a table");
  command->add_option("-n,--nu", o.nus, "candidates")->delimiter(',')->capture_default_str();
  command
      ->add_option("-g,--gamma", o.gammas,
                   "candidates; default: 1/16, 1/8, ... 16 over the number of features")
      ->delimiter(',');
  command
      ->add_option("-l,--length", o.length,
                   "samples of one demonstration, in successive lines; they are held out together")
      ->check(dfr::apps::kPositive)
      ->capture_default_str();
  command->add_option("-f,--folds", o.folds, "parts, held out in turn")->capture_default_str();
  command->add_option("-a,--acceptance", o.acceptance, "share of held-out samples inside")
      ->capture_default_str();
  command->add_option("--threads", o.threads, "0: one per core; the results are the same")
      ->check(dfr::apps::kNotNegative)
      ->capture_default_str();
  command->add_option("--picture", o.picture, "write an SVG of the comparison");
  command->add_option("DATA", o.data)->required();
}

}  // namespace

int main(int argc, char** argv) try {
  dfr::apps::IgnoreFileSizeSignal();
  CLI::App app(
      "One-class SVMs with the Gaussian kernel. DATA is LIBSVM's sparse form or "
      "comma-separated values, one sample a line; MODEL is LIBSVM's model file.");
  app.require_subcommand(1);
  TrainOptions train;
  const CLI::App* train_command = AddTrain(app, train);
  PredictOptions predict;
  const CLI::App* predict_command = AddPredict(app, predict);
  TuneOptions tune;
  AddTune(app, tune);
  dfr::apps::CheckNumbers(app);
  CLI11_PARSE(app, argc, argv);
  // Ctrl-C ends it: there is nothing to keep.
  if (predict_command->parsed()) return Predict(predict);
  std::signal(SIGINT, [](int) { interrupted = 1; });
  if (train_command->parsed()) return Train(train);
  return Tune(tune);
} catch (const std::exception& e) {
  std::fprintf(stderr, "ocsvm: %s\n", e.what());
  return EXIT_FAILURE;
}
