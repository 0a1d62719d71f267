// SPDX-License-Identifier: GPL-3.0-or-later
// Distribution of work to threads; sums are of integers and so independent of the order.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <system_error>
#include <thread>
#include <vector>

namespace mesher {

// Calls work(begin, end) on chunks of [0, count) until all are done; rethrows the first exception.
template <typename Work>
void ParallelChunks(std::int64_t count, int num_threads, Work&& work) {
  constexpr std::int64_t kChunk = 256;
  std::atomic<std::int64_t> next{0};
  auto run = [&](std::exception_ptr& error) {
    try {
      for (std::int64_t begin; (begin = next.fetch_add(kChunk)) < count;)
        work(begin, std::min(begin + kChunk, count));
    } catch (...) {
      error = std::current_exception();
    }
  };
  std::vector<std::exception_ptr> errors(std::max(num_threads, 1));
  std::vector<std::thread> threads;
  threads.reserve(errors.size());
  try {
    for (std::size_t i = 1; i < errors.size(); ++i) threads.emplace_back(run, std::ref(errors[i]));
  } catch (const std::system_error&) {
    // The system refuses more threads; the existing ones do the work.
  }
  run(errors[0]);
  for (auto& thread : threads) thread.join();
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

// Adds atomically to a sum.
template <typename T>
void AtomicAdd(T& sum, T value) {
  __atomic_fetch_add(&sum, value, __ATOMIC_RELAXED);
}

}  // namespace mesher
