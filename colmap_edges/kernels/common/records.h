// Records of different lengths in a file, with headers that end with a count.
#pragma once

#include <algorithm>
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

enum class TrackFault { kNone, kImage, kPoint2D };

// Whether the tracks behind headers at `starts` name known images and points2D of these. An element
// is the id of an image and the index of a point2D, 4 bytes each; `image_ids` are ascending.
inline TrackFault CheckTracks(const uint8_t* data, const int64_t* starts, const int64_t* counts,
                              int64_t num_records, int64_t head_size, const int64_t* image_ids,
                              const int64_t* num_points2D, int64_t num_images) {
  TrackFault fault = TrackFault::kNone;
  for (int64_t i = 0; i < num_records; ++i) {
    const uint8_t* element = data + starts[i] + head_size;
    for (int64_t k = 0; k < counts[i]; ++k, element += 8) {
      uint32_t fields[2];
      std::memcpy(fields, element, sizeof(fields));
      const int64_t at =
          std::lower_bound(image_ids, image_ids + num_images, int64_t(fields[0])) - image_ids;
      if (at == num_images || image_ids[at] != fields[0]) return TrackFault::kImage;
      if (fields[1] >= num_points2D[at]) fault = TrackFault::kPoint2D;
    }
  }
  return fault;
}

}  // namespace colmap_edges
