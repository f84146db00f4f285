// What a node of a graph does, and what is kept of it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "rt_tests_support/clock.h"
#include "rt_tests_support/measure/graph.h"

namespace topology {

// Rows of int64, room for all of them allocated and touched before the first activation.
class Table {
 public:
  Table(int64_t rows, std::size_t columns)
      : columns_(columns), room_(static_cast<std::size_t>(rows)), values_(room_ * columns) {}

  // The next row, to be filled; nullptr when all are in use.
  int64_t* append() noexcept { return rows_ == room_ ? nullptr : &values_[rows_++ * columns_]; }
  int64_t* row(std::size_t number) noexcept { return &values_[number * columns_]; }
  std::size_t rows() const noexcept { return rows_; }
  std::size_t columns() const noexcept { return columns_; }
  const int64_t* data() const noexcept { return values_.data(); }

 private:
  const std::size_t columns_;
  const std::size_t room_;
  std::vector<int64_t> values_;
  std::size_t rows_ = 0;
};

// What a node is made of while it runs. One thread alone uses it.
class HostedNode {
 public:
  static constexpr int64_t none = -1;
  // Of an activation; a column for each input follows: the number of the message that it took.
  enum Column : std::size_t { release_ns, begin_ns, done_ns, end_ns, cpu_ns, first_input };
  enum ReceptionColumn : std::size_t { seq, publication_ns, reception_ns, taken, reception_columns };

  explicit HostedNode(const Node& description)
      : description(&description),
        activations(description.activations_max, first_input + description.inputs.size()),
        newest_(description.inputs.size(), none),
        touched_(static_cast<std::size_t>(description.touched_bytes), 1) {
    for (const Input& input : description.inputs) receptions.emplace_back(input.messages_max, reception_columns);
  }

  // Keeps a message of an input. False: there is no room for it.
  bool receive(std::size_t input, const Head& head, int64_t now_ns) noexcept {
    Table& table = receptions[input];
    int64_t* const row = table.append();
    if (!row) return false;
    row[seq] = static_cast<int64_t>(head.seq);
    row[publication_ns] = head.publication_ns;
    row[reception_ns] = now_ns;
    row[taken] = none;
    newest_[input] = static_cast<int64_t>(table.rows()) - 1;
    return true;
  }

  // Whether every input has a message that no activation has taken.
  bool has_all_new() noexcept {
    for (std::size_t input = 0; input < newest_.size(); ++input) {
      if (newest_[input] == none || newest(input)[taken] != none) return false;
    }
    return true;
  }

  // One activation: takes the newest message of each input, or of `only` one, does its work, and has each of its outputs
  // published by `publish(output, seq)`. False: there is no room for it.
  template <class Publish>
  bool activate(int64_t due_ns, std::size_t only, Publish publish) {
    const auto number = static_cast<int64_t>(activations.rows());
    int64_t* const row = activations.append();
    if (!row) return false;
    const int64_t cpu_begin_ns = rt_tests::now_ns(CLOCK_THREAD_CPUTIME_ID);
    row[release_ns] = due_ns;
    row[begin_ns] = rt_tests::now_ns(CLOCK_MONOTONIC);
    for (std::size_t input = 0; input < newest_.size(); ++input) {
      const bool takes = newest_[input] != none && (only == all_inputs || only == input);
      row[first_input + input] = takes ? newest(input)[seq] : none;
      if (takes && newest(input)[taken] == none) newest(input)[taken] = number;
    }
    work(cpu_begin_ns);
    row[done_ns] = rt_tests::now_ns(CLOCK_MONOTONIC);
    for (std::size_t output = 0; output < description->outputs.size(); ++output) publish(output, number);
    row[end_ns] = rt_tests::now_ns(CLOCK_MONOTONIC);
    row[cpu_ns] = rt_tests::now_ns(CLOCK_THREAD_CPUTIME_ID) - cpu_begin_ns;
    return true;
  }
  static constexpr std::size_t all_inputs = static_cast<std::size_t>(-1);

  const Node* const description;
  Table activations;
  std::vector<Table> receptions;  // of each input
  int64_t period = 0;             // the number of the next one
  int64_t skipped = 0;            // periods without an activation, as the one before was not over

 private:
  static constexpr std::size_t cache_line_bytes = 64;

  int64_t* newest(std::size_t input) noexcept { return receptions[input].row(static_cast<std::size_t>(newest_[input])); }

  void work(int64_t cpu_begin_ns) noexcept {
    volatile unsigned char* const bytes = touched_.data();
    for (std::size_t i = 0; i < touched_.size(); i += cache_line_bytes) bytes[i] = static_cast<unsigned char>(bytes[i] + 1);
    while (rt_tests::now_ns(CLOCK_THREAD_CPUTIME_ID) - cpu_begin_ns < description->busy_ns) {
    }
  }

  std::vector<int64_t> newest_;  // the row of the reception, by input
  std::vector<unsigned char> touched_;
};

}  // namespace topology
