// Runs independent tasks on threads; results must not depend on their assignment to threads.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

namespace colmap_edges {

// Calls work(index, worker) for each index in [0, count); `worker` is in [0, num_threads).
// The first exception is rethrown on the calling thread.
template <typename Work>
void ParallelFor(int64_t count, int num_threads, const Work& work) {
  std::atomic<int64_t> next{0};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto run = [&](int worker) {
    try {
      for (int64_t i = next++; i < count; i = next++) work(i, worker);
    } catch (...) {
      const std::lock_guard<std::mutex> lock(error_mutex);
      if (!error) error = std::current_exception();
      next = count;
    }
  };
  const int workers = int(std::max<int64_t>(1, std::min<int64_t>(num_threads, count)));
  std::vector<std::thread> threads;
  threads.reserve(workers);
  try {
    for (int worker = 1; worker < workers; ++worker) threads.emplace_back(run, worker);
  } catch (const std::exception&) {
    // The system refuses more threads or their memory; the existing ones do the work.
  }
  run(0);
  for (std::thread& thread : threads) thread.join();
  if (error) std::rethrow_exception(error);
}

// Calls body(i) once for each i in [0, count), for cheap bodies: items are handed out in blocks.
template <typename Body>
void ParallelBlocks(int64_t count, int num_threads, int64_t block, const Body& body) {
  ParallelFor((count + block - 1) / block, num_threads, [&](int64_t b, int) {
    for (int64_t i = b * block; i < std::min((b + 1) * block, count); ++i) body(i);
  });
}

}  // namespace colmap_edges
