#include "bench/kernel/peers.h"

#include <dlib/svm/svm_one_class_trainer.h>
#include <libsvm/svm.h>

#include <opencv2/core.hpp>
#include <opencv2/ml.hpp>
#include <stdexcept>
#include <vector>

namespace dfr::bench {
namespace {

class Libsvm final : public Peer {
 public:
  Libsvm(const core::Matrix& samples, const PeerOptions& options) {
    svm_set_print_string_function([](const char*) {});
    Fill(samples, training_nodes_, training_rows_);
    std::vector<double> labels(training_rows_.size(), 1.0);
    svm_problem problem{static_cast<int>(labels.size()), labels.data(), training_rows_.data()};
    svm_parameter parameter{};
    parameter.svm_type = ONE_CLASS;
    parameter.kernel_type = RBF;
    parameter.gamma = options.gamma;
    parameter.nu = options.nu;
    parameter.eps = options.tolerance;
    parameter.cache_size = 200;
    parameter.shrinking = 1;
    if (const char* error = svm_check_parameter(&problem, &parameter)) {
      throw std::invalid_argument(error);
    }
    model_ = svm_train(&problem, &parameter);
  }
  ~Libsvm() override { svm_free_and_destroy_model(&model_); }
  Libsvm(const Libsvm&) = delete;
  Libsvm& operator=(const Libsvm&) = delete;

  double Decide(int i) override { return DecideRow(rows_[static_cast<std::size_t>(i)]); }
  void DecideAll(std::span<double> values) override {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = DecideRow(rows_[i]);
  }
  void Prepare(const core::Matrix& queries) override { Fill(queries, nodes_, rows_); }
  int num_support_vectors() const override { return model_->l; }
  double Objective() const {
    double objective = 0.0;
    for (int i = 0; i < model_->l; ++i) {
      objective += 0.5 * model_->sv_coef[0][i] * (DecideRow(model_->SV[i]) + model_->rho[0]);
    }
    return objective;
  }

 private:
  static void Fill(const core::Matrix& x, std::vector<svm_node>& nodes,
                   std::vector<svm_node*>& rows) {
    nodes.clear();
    rows.clear();
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
      for (Eigen::Index k = 0; k < x.cols(); ++k) {
        nodes.push_back({static_cast<int>(k) + 1, x(i, k)});
      }
      nodes.push_back({-1, 0.0});
    }
    for (std::size_t i = 0; i < nodes.size(); i += static_cast<std::size_t>(x.cols()) + 1) {
      rows.push_back(&nodes[i]);
    }
  }
  double DecideRow(const svm_node* row) const {
    double value = 0.0;
    svm_predict_values(model_, row, &value);
    return value;
  }

  std::vector<svm_node> training_nodes_, nodes_;
  std::vector<svm_node*> training_rows_, rows_;
  svm_model* model_ = nullptr;
};

cv::Mat ToFloat(const core::Matrix& x) {
  cv::Mat result(static_cast<int>(x.rows()), static_cast<int>(x.cols()), CV_32F);
  for (int i = 0; i < result.rows; ++i) {
    for (int k = 0; k < result.cols; ++k) result.at<float>(i, k) = static_cast<float>(x(i, k));
  }
  return result;
}

class OpenCv final : public Peer {
 public:
  OpenCv(const core::Matrix& samples, const PeerOptions& options) : svm_(cv::ml::SVM::create()) {
    cv::setNumThreads(1);
    svm_->setType(cv::ml::SVM::ONE_CLASS);
    svm_->setKernel(cv::ml::SVM::RBF);
    svm_->setGamma(options.gamma);
    svm_->setNu(options.nu);
    svm_->setTermCriteria(cv::TermCriteria(cv::TermCriteria::EPS + cv::TermCriteria::MAX_ITER,
                                           10'000'000, options.tolerance));
    const cv::Mat data = ToFloat(samples);
    svm_->train(data, cv::ml::ROW_SAMPLE, cv::Mat::ones(data.rows, 1, CV_32S));
  }

  double Decide(int i) override {
    svm_->predict(rows_[static_cast<std::size_t>(i)], result_, cv::ml::StatModel::RAW_OUTPUT);
    return result_.at<float>(0);
  }
  void DecideAll(std::span<double> values) override {
    svm_->predict(queries_, result_, cv::ml::StatModel::RAW_OUTPUT);
    for (std::size_t i = 0; i < values.size(); ++i) {
      values[i] = result_.at<float>(static_cast<int>(i));
    }
  }
  void Prepare(const core::Matrix& queries) override {
    queries_ = ToFloat(queries);
    rows_.clear();
    for (int i = 0; i < queries_.rows; ++i) rows_.push_back(queries_.row(i));
  }
  int num_support_vectors() const override { return svm_->getUncompressedSupportVectors().rows; }

 private:
  cv::Ptr<cv::ml::SVM> svm_;
  cv::Mat queries_, result_;
  std::vector<cv::Mat> rows_;
};

class Dlib final : public Peer {
 public:
  using Sample = dlib::matrix<double, 0, 1>;
  using Kernel = dlib::radial_basis_kernel<Sample>;

  Dlib(const core::Matrix& samples, const PeerOptions& options) {
    dlib::svm_one_class_trainer<Kernel> trainer(Kernel(options.gamma), options.nu);
    trainer.set_epsilon(options.tolerance);
    decision_ = trainer.train(Convert(samples));
  }

  double Decide(int i) override { return decision_(queries_[static_cast<std::size_t>(i)]); }
  void DecideAll(std::span<double> values) override {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = decision_(queries_[i]);
  }
  void Prepare(const core::Matrix& queries) override { queries_ = Convert(queries); }
  int num_support_vectors() const override {
    return static_cast<int>(decision_.basis_vectors.size());
  }

 private:
  static std::vector<Sample> Convert(const core::Matrix& x) {
    std::vector<Sample> rows;
    for (Eigen::Index i = 0; i < x.rows(); ++i) {
      Sample row(x.cols());
      for (Eigen::Index k = 0; k < x.cols(); ++k) row(k) = x(i, k);
      rows.push_back(row);
    }
    return rows;
  }
  dlib::decision_function<Kernel> decision_;
  std::vector<Sample> queries_;
};

class EigenSum final : public Peer {
 public:
  EigenSum(const core::Matrix& support_vectors, Eigen::VectorXd alpha, double gamma, double rho)
      : transposed_(support_vectors.transpose()),
        alpha_(std::move(alpha)),
        gamma_(gamma),
        rho_(rho),
        work_(alpha_.size()) {}

  double Decide(int i) override {
    work_ =
        (-gamma_ * (transposed_.colwise() - queries_.col(i)).colwise().squaredNorm().array()).exp();
    return work_.dot(alpha_) - rho_;
  }
  void DecideAll(std::span<double> values) override {
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = Decide(static_cast<int>(i));
  }
  void Prepare(const core::Matrix& queries) override { queries_ = queries.transpose(); }
  int num_support_vectors() const override { return static_cast<int>(alpha_.size()); }

 private:
  Eigen::MatrixXd transposed_;  // one support vector per column, contiguous
  Eigen::VectorXd alpha_;
  double gamma_;
  double rho_;
  Eigen::VectorXd work_;
  Eigen::MatrixXd queries_;
};

}  // namespace

std::unique_ptr<Peer> TrainLibsvm(const core::Matrix& samples, const PeerOptions& options) {
  return std::make_unique<Libsvm>(samples, options);
}
std::unique_ptr<Peer> TrainOpenCv(const core::Matrix& samples, const PeerOptions& options) {
  return std::make_unique<OpenCv>(samples, options);
}
std::unique_ptr<Peer> TrainDlib(const core::Matrix& samples, const PeerOptions& options) {
  return std::make_unique<Dlib>(samples, options);
}
std::unique_ptr<Peer> PlainEigen(const core::Matrix& support_vectors, const Eigen::VectorXd& alpha,
                                 double gamma, double rho) {
  return std::make_unique<EigenSum>(support_vectors, alpha, gamma, rho);
}

double LibsvmObjective(const Peer& libsvm) {
  return dynamic_cast<const Libsvm&>(libsvm).Objective();
}

}  // namespace dfr::bench
