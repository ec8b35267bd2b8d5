#pragma once

// Raw payloads on ROS 2 topics, past our own codec: bytes as they are on the wire, for tests only.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

namespace tagdock::test {

using Bytes = std::vector<unsigned char>;

/// A participant of its own, beside those of the program under test.
class RawParticipant {
 public:
  explicit RawParticipant(int domain) : participant_(dds_create_participant(domain, nullptr, nullptr)) {
    if (participant_ < 0) throw std::runtime_error("no participant");
  }
  ~RawParticipant() { dds_delete(participant_); }
  RawParticipant(const RawParticipant&) = delete;
  RawParticipant& operator=(const RawParticipant&) = delete;

  [[nodiscard]] dds_entity_t entity() const { return participant_; }

 private:
  dds_entity_t participant_;
};

/// Writes any bytes as the payload of a topic of any type: each length is announced as an array of octets, which is
/// what a final type without strings looks like on the wire, under the name of the type that the reader expects.
class RawWriter {
 public:
  RawWriter(const RawParticipant& participant, std::string topic, std::string type)
      : participant_(participant.entity()), topic_("rt" + topic), type_(std::move(type)) {}
  ~RawWriter() {
    for (auto& [size, writer] : writers_) {
      dds_delete(writer.writer);
      dds_delete(writer.topic);
    }
  }
  RawWriter(const RawWriter&) = delete;
  RawWriter& operator=(const RawWriter&) = delete;

  /// @param cdr  without the four bytes of encapsulation; at least one byte
  void write(const Bytes& cdr) { dds_write(writer(static_cast<std::uint32_t>(cdr.size())), cdr.data()); }
  /// Readers that the writer of this length has.
  int matched(std::size_t size) {
    dds_publication_matched_status_t status{};
    dds_get_publication_matched_status(writer(static_cast<std::uint32_t>(size)), &status);
    return static_cast<int>(status.current_count);
  }

 private:
  struct Writer {
    std::vector<std::uint32_t> operations;
    dds_entity_t topic = 0;
    dds_entity_t writer = 0;
  };

  dds_entity_t writer(std::uint32_t size) {
    Writer& one = writers_[size];
    if (one.writer != 0) return one.writer;
    constexpr std::uint32_t bytes = static_cast<std::uint32_t>(DDS_OP_ADR) |
                                    static_cast<std::uint32_t>(DDS_OP_TYPE_ARR) |
                                    static_cast<std::uint32_t>(DDS_OP_SUBTYPE_1BY);
    one.operations = {bytes, 0, size, DDS_OP_RTS};
    const dds_topic_descriptor_t descriptor = {size,         1, DDS_TOPIC_FIXED_SIZE,  0,  type_.c_str(),
                                               nullptr,      2, one.operations.data(), "", {nullptr, 0},
                                               {nullptr, 0}, 0};
    one.topic = dds_create_topic(participant_, &descriptor, topic_.c_str(), nullptr, nullptr);
    if (one.topic < 0) throw std::runtime_error(std::string("no raw topic: ") + dds_strretcode(one.topic));
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_MSECS(1000));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 100);
    one.writer = dds_create_writer(participant_, one.topic, qos, nullptr);
    dds_delete_qos(qos);
    if (one.writer < 0) throw std::runtime_error(std::string("no raw writer: ") + dds_strretcode(one.writer));
    return one.writer;
  }

  dds_entity_t participant_;
  std::string topic_;
  std::string type_;
  std::map<std::uint32_t, Writer> writers_;
};

/// Takes the payloads of a topic as they came.
class RawReader {
 public:
  RawReader(const RawParticipant& participant, const std::string& topic, const dds_topic_descriptor_t& descriptor) {
    topic_ = dds_create_topic(participant.entity(), &descriptor, ("rt" + topic).c_str(), nullptr, nullptr);
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, 0);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 100);
    reader_ = dds_create_reader(participant.entity(), topic_, qos, nullptr);
    dds_delete_qos(qos);
    if (reader_ < 0) throw std::runtime_error(std::string("no raw reader: ") + dds_strretcode(reader_));
  }
  ~RawReader() {
    dds_delete(reader_);
    dds_delete(topic_);
  }
  RawReader(const RawReader&) = delete;
  RawReader& operator=(const RawReader&) = delete;

  /// With the four bytes of encapsulation before the payload.
  std::vector<Bytes> take() {
    struct ddsi_serdata* data[100] = {nullptr};
    dds_sample_info_t infos[100];
    std::vector<Bytes> all;
    const dds_return_t count = dds_takecdr(reader_, data, 100, infos, DDS_ANY_STATE);
    for (dds_return_t i = 0; i < count; ++i) {
      if (infos[i].valid_data) {
        Bytes bytes(ddsi_serdata_size(data[i]));
        ddsi_serdata_to_ser(data[i], 0, bytes.size(), bytes.data());
        all.push_back(std::move(bytes));
      }
      ddsi_serdata_unref(data[i]);
    }
    return all;
  }

 private:
  dds_entity_t topic_ = 0;
  dds_entity_t reader_ = 0;
};

// What goes wrong with bytes: single bits, bytes, words of special value, and cut or longer ends.
inline void spoil(Bytes& bytes, std::mt19937& random) {
  const std::size_t changes = 1 + random() % 4;
  for (std::size_t i = 0; i < changes; ++i) {
    // Three fifths of an odometry message are covariances, which nobody reads: half of the changes go elsewhere.
    const std::size_t anywhere = random() % bytes.size();
    const std::size_t at =
        random() % 2 == 0 ? anywhere : std::min(bytes.size() - 1, anywhere % 2 * 400 + random() % 110);
    switch (random() % 4) {
      case 0:
        bytes[at] ^= static_cast<unsigned char>(1U << (random() % 8));
        break;
      case 1:
        bytes[at] = static_cast<unsigned char>(random());
        break;
      case 2: {
        const std::uint32_t words[] = {0, 1, 0xffffffffU, 0x7fffffffU, 0x80000000U, 0x7ff00000U, 0x7ff80000U, 0x10000U};
        const std::uint32_t word = words[random() % 8];
        const std::size_t start = at / 4 * 4;
        for (std::size_t k = 0; k < 4 && start + k < bytes.size(); ++k)
          bytes[start + k] = static_cast<unsigned char>(word >> (8 * k));
        break;
      }
      default:
        std::swap(bytes[at], bytes[random() % bytes.size()]);
    }
  }
  // A few lengths only: each is a writer of its own.
  if (random() % 16 == 0) bytes.resize(std::max<std::size_t>(4, bytes.size() - 4 * (1 + random() % 6)), 0);
}

}  // namespace tagdock::test
