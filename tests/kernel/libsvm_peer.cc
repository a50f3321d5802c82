#include "tests/kernel/libsvm_peer.h"

#include <libsvm/svm.h>

#include <cmath>
#include <stdexcept>

namespace dfr::kernel::test {
namespace {

std::vector<svm_node> Nodes(std::span<const double> x) {
  std::vector<svm_node> nodes;
  for (std::size_t k = 0; k < x.size(); ++k) nodes.push_back({static_cast<int>(k) + 1, x[k]});
  nodes.push_back({-1, 0.0});
  return nodes;
}

}  // namespace

LibsvmPeer::LibsvmPeer(const core::Matrix& samples, double nu, double gamma, double tolerance) {
  svm_set_print_string_function([](const char*) {});
  const auto width = static_cast<std::size_t>(samples.cols()) + 1;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    const auto row = Nodes(core::Row(samples, i));
    nodes_.insert(nodes_.end(), row.begin(), row.end());
  }
  std::vector<svm_node*> rows;
  for (std::size_t i = 0; i < nodes_.size(); i += width) rows.push_back(&nodes_[i]);
  std::vector<double> labels(rows.size(), 1.0);
  svm_problem problem{static_cast<int>(rows.size()), labels.data(), rows.data()};
  svm_parameter parameter{};
  parameter.svm_type = ONE_CLASS;
  parameter.kernel_type = RBF;
  parameter.gamma = gamma;
  parameter.nu = nu;
  parameter.eps = tolerance;
  parameter.cache_size = 200;
  parameter.shrinking = 1;
  if (const char* error = svm_check_parameter(&problem, &parameter)) {
    throw std::invalid_argument(error);
  }
  model_ = svm_train(&problem, &parameter);
}

LibsvmPeer::~LibsvmPeer() { svm_free_and_destroy_model(&model_); }

double LibsvmPeer::Decision(std::span<const double> x) const {
  double value = 0.0;
  svm_predict_values(model_, Nodes(x).data(), &value);
  return value;
}

double LibsvmPeer::rho() const { return model_->rho[0]; }

int LibsvmPeer::num_support_vectors() const { return model_->l; }

double LibsvmPeer::Objective() const {
  double objective = 0.0;
  for (int i = 0; i < model_->l; ++i) {
    double value = 0.0;
    svm_predict_values(model_, model_->SV[i], &value);
    objective += 0.5 * model_->sv_coef[0][i] * (value + model_->rho[0]);
  }
  return objective;
}

core::Matrix Tube(int m, int n, core::Random& random) {
  core::Matrix samples(m, n);
  for (int i = 0; i < m; ++i) {
    const double phase = random.Uniform(0.0, 3.0);
    for (int k = 0; k < n; ++k) {
      samples(i, k) = std::sin((1.0 + 0.3 * k) * phase + k) + 0.1 * random.Normal();
    }
  }
  return samples;
}

}  // namespace dfr::kernel::test
