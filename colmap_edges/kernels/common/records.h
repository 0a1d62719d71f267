// Records of different lengths in a file, with headers that end with a count.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

namespace colmap_edges {

struct Records {
  std::vector<int64_t> starts, counts;
  int64_t end = 0;  // of the last record; one byte past the data if these end within a record
};

// Iterates over `num_records` records from byte `first`: a header of `head_size` bytes, whose last
// eight bytes are the number of the following elements of `element_size` bytes.
inline Records WalkRecords(const uint8_t* data, int64_t size, int64_t first, uint64_t num_records,
                           int64_t head_size, int64_t element_size) {
  Records result;
  int64_t at = first;
  for (uint64_t i = 0; i < num_records; ++i) {
    uint64_t count;
    if (head_size > size - at) return result.end = size + 1, result;
    std::memcpy(&count, data + at + head_size - sizeof(count), sizeof(count));
    if (count > uint64_t(size - at - head_size) / uint64_t(element_size))
      return result.end = size + 1, result;
    result.starts.push_back(at), result.counts.push_back(int64_t(count));
    at += head_size + int64_t(count) * element_size;
  }
  result.end = at;
  return result;
}

}  // namespace colmap_edges
