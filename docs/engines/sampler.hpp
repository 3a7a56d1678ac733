// The sampling loop of sampler.py in C++17, with the standard library alone: for ONNX Runtime (sampler.cpp), Unreal's
// NNE and others, which implement `Graphs`. docs/engines.md explains each step, and tests compare it with sampler.py.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace t2m {

/// The codes of one row, or of all rows of a motion one after the other.
using Codes = std::vector<std::int32_t>;

/// What `manifest.json` says about a model.
struct Rules {
  std::size_t max_rows, min_rows;      // sampling
  std::size_t num_quantizers, classes; // graphs.row.inputs.noise.shape: [1, num_quantizers, classes]
  std::string stop_rule;               // sampling.stop: end, threshold, sampled or argmax
  double stop_threshold;
  bool keeps_last;
  std::size_t frames_per_row, context_rows; // motion
};

struct Row {
  Codes codes;
  float stop_score;
};

/// The graphs of a model. The state stays in here: a game needs not look at it.
class Graphs {
public:
  virtual ~Graphs() = default;
  /// Runs `begin`, and keeps the state that it gives.
  virtual void begin(const std::vector<float> &text_embedding, float guidance_scale) = 0;
  /// Runs `row`, and keeps the next state.
  virtual Row row(const std::vector<float> &noise, float temperature, bool may_stop) = 0;
  /// Runs `decode`; `codes` has `max_rows` rows. Returns positions in meters, [frames, joints, 3].
  virtual std::vector<float> decode(const Codes &codes, std::int32_t num_rows) = 0;
  /// Runs `calm` and `lock`; `positions` has zeros after `num_frames` frames. Without these graphs, returns them as they are.
  virtual std::vector<float> clean(const std::vector<float> &positions, std::int32_t num_frames) = 0;
};

/// Returns number `index` of a seed, above 0 and below 1: SplitMix64, which gives the same in every language.
inline double uniform(std::uint64_t seed, std::uint64_t index) {
  std::uint64_t bits = seed + 0x9E3779B97F4A7C15u * (index + 1);
  bits = (bits ^ (bits >> 30)) * 0xBF58476D1CE4E5B9u;
  bits = (bits ^ (bits >> 27)) * 0x94D049BB133111EBu;
  return (static_cast<double>((bits ^ (bits >> 31)) >> 12) + 0.5) / 4503599627370496.0; // 2^52
}

/// Makes one motion, a row at each step, so that a game can do one step in each frame.
class Sampler {
public:
  Sampler(Graphs &graphs, Rules rules, std::uint64_t seed, float temperature = 1.0f)
      : graphs_(graphs), rules_(std::move(rules)), seed_(seed), temperature_(temperature) {}

  void begin(const std::vector<float> &text_embedding, float guidance_scale) {
    graphs_.begin(text_embedding, guidance_scale);
  }

  /// Makes a row; returns false if the motion has ended.
  bool step() {
    if (ended_)
      return false;
    const std::size_t width = rules_.num_quantizers * rules_.classes;
    const std::uint64_t first = made_ * (width + 1);
    std::vector<float> noise(width);
    for (std::size_t i = 0; i < width; ++i)
      noise[i] = static_cast<float>(-std::log(-std::log(uniform(seed_, first + i))));
    const bool may_stop = made_ + (rules_.keeps_last ? 1 : 0) >= rules_.min_rows;
    const Row row = graphs_.row(noise, temperature_, may_stop);
    ++made_;
    const double last = uniform(seed_, first + width);
    const bool stops = may_stop && stops_with(row.stop_score, std::log(last / (1 - last)));
    if (!stops || rules_.keeps_last)
      codes_.insert(codes_.end(), row.codes.begin(), row.codes.end());
    if (may_stop && row.stop_score > best_score_) {
      best_score_ = row.stop_score;
      best_rows_ = made_;
    }
    ended_ = stops || made_ == rules_.max_rows;
    if (ended_ && rules_.stop_rule == "argmax")
      codes_.resize(best_rows_ * rules_.num_quantizers);
    return !ended_;
  }

  /// Codes so far, [rows, num_quantizers].
  const Codes &codes() const { return codes_; }

  /// How many frames of `decode` are valid, and how many of them no later row changes.
  std::size_t num_frames() const { return num_rows() * rules_.frames_per_row; }
  std::size_t num_final_frames() const {
    if (ended_)
      return num_frames();
    if (rules_.stop_rule == "argmax" || num_rows() <= rules_.context_rows)
      return 0;
    return (num_rows() - rules_.context_rows) * rules_.frames_per_row;
  }

  /// Returns positions of the rows so far in meters, [num_frames, joints, 3].
  std::vector<float> decode() {
    Codes padded = codes_;
    padded.resize(rules_.max_rows * rules_.num_quantizers, 0);
    std::vector<float> positions = graphs_.decode(padded, static_cast<std::int32_t>(num_rows()));
    positions.resize(positions.size() / max_frames() * num_frames());
    return positions;
  }

  /// Returns positions of a motion that has ended with less trembling, rigid bones and feet that stand still.
  std::vector<float> clean() {
    std::vector<float> positions = decode();
    const std::size_t size = positions.size();
    if (size == 0)
      return positions;
    positions.resize(size / num_frames() * max_frames(), 0.0f);
    positions = graphs_.clean(positions, static_cast<std::int32_t>(num_frames()));
    positions.resize(size);
    return positions;
  }

private:
  std::size_t num_rows() const { return codes_.size() / rules_.num_quantizers; }
  std::size_t max_frames() const { return rules_.max_rows * rules_.frames_per_row; }

  bool stops_with(double score, double logistic) const {
    if (rules_.stop_rule == "end")
      return score > 0.5;
    if (rules_.stop_rule == "threshold")
      return 1 / (1 + std::exp(-score)) >= rules_.stop_threshold;
    return rules_.stop_rule == "sampled" && score + logistic > 0; // argmax is cut at the end
  }

  Graphs &graphs_;
  Rules rules_;
  std::uint64_t seed_;
  float temperature_;
  Codes codes_;
  std::size_t made_ = 0, best_rows_ = 1;
  float best_score_ = -std::numeric_limits<float>::infinity();
  bool ended_ = false;
};

/// Returns a joint in Unreal's axes: X ahead, Y to the right, Z up, in centimeters.
inline std::array<float, 3> in_unreal(const float *joint) {
  return {100 * joint[2], -100 * joint[0], 100 * joint[1]};
}

} // namespace t2m
