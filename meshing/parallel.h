// SPDX-License-Identifier: GPL-3.0-or-later
// Distribution of work to threads; sums are of integers and so independent of the order.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <optional>
#include <thread>
#include <type_traits>
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
  } catch (const std::exception&) {
    // The system refuses more threads or their memory; the existing ones do the work.
  }
  run(errors[0]);
  for (auto& thread : threads) thread.join();
  for (const auto& error : errors)
    if (error) std::rethrow_exception(error);
}

// Steps through several items in turn, so that the processor works on the others while one waits
// for memory or arithmetic. start() returns the next item, or nothing after the last; step(item)
// returns whether it goes on.
template <typename Start, typename Step>
void TakeTurns(Start&& start, Step&& step) {
  constexpr std::size_t kTogether = 4;
  typename std::invoke_result_t<Start> items[kTogether];
  std::size_t count = 0;
  while (count < kTogether && (items[count] = start())) ++count;
  while (count > 0)
    for (std::size_t i = 0; i < count; ++i)
      if (!step(*items[i]) && !(items[i] = start())) items[i] = items[--count];
}

// Adds atomically to a sum.
template <typename T>
void AtomicAdd(T& sum, T value) {
  __atomic_fetch_add(&sum, value, __ATOMIC_RELAXED);
}

}  // namespace mesher
