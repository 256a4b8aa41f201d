// A node on Fast DDS of which a test makes and reads the bytes: what rmw_fastrtps_cpp stands on.
//
//   fast_dds_node DOMAIN {WRITER|READER|KEPT_WRITER|LOSSY_WRITER|LOSSY_READER TOPIC TYPE}...
//
// LOSSY is best effort, all others are reliable; KEPT is TRANSIENT_LOCAL with the last message.
//
// stdin has frames of messages to write, and stdout frames of those that were read: the number of
// the end and the length of what follows, as 32-bit integers in the order of this processor, and
// the message, in CDR with its header of 4 bytes. Before it reads, the node writes the 16 bytes of
// the GUID of each end in their order, and last those of its participant, in frames whose numbers
// begin at the count of ends. It ends with stdin.
//
// It is on loopback alone, without multicast, as the bridge of tests/support/ros2_bridge.py is.

#include <unistd.h>

#include <cstdint>
#include <cstring>
#include <iostream>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;

namespace {

using Bytes = std::vector<char>;

constexpr uint32_t kMostBytes = 1 << 16;
constexpr int kDepth = 10;  // messages, ROS's default

// A message of any type, as the bytes that are on the wire.
class BytesType : public fast::TopicDataType {
  public:
    explicit BytesType(const std::string &name) {
        setName(name.c_str());
        m_typeSize = kMostBytes;
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }

    bool serialize(void *data, rtps::SerializedPayload_t *payload) override {
        const Bytes &message = *static_cast<Bytes *>(data);
        if (message.size() > payload->max_size) {
            return false;
        }
        std::memcpy(payload->data, message.data(), message.size());
        payload->length = static_cast<uint32_t>(message.size());
        payload->encapsulation = CDR_LE;
        return true;
    }

    bool deserialize(rtps::SerializedPayload_t *payload, void *data) override {
        static_cast<Bytes *>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void *data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes *>(data)->size()); };
    }

    void *createData() override { return new Bytes; }
    void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
    bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
};

// Frames to stdout, from the threads of all readers.
class Frames {
  public:
    void write(uint32_t number, const void *bytes, size_t count) {
        const std::lock_guard<std::mutex> lock(mutex_);
        const uint32_t head[] = {number, static_cast<uint32_t>(count)};
        std::cout.write(reinterpret_cast<const char *>(head), sizeof head);
        std::cout.write(static_cast<const char *>(bytes), static_cast<std::streamsize>(count));
        std::cout.flush();
    }

    void write_guid(uint32_t number, const rtps::GUID_t &guid) {
        unsigned char whole[16];
        std::memcpy(whole, guid.guidPrefix.value, 12);
        std::memcpy(whole + 12, guid.entityId.value, 4);
        write(number, whole, sizeof whole);
    }

  private:
    std::mutex mutex_;
};

class Listener : public fast::DataReaderListener {
  public:
    Listener(Frames &frames, uint32_t number) : frames_(frames), number_(number) {}

    void on_data_available(fast::DataReader *reader) override {
        Bytes message;
        fast::SampleInfo info;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
            if (info.valid_data) {
                frames_.write(number_, message.data(), message.size());
            }
        }
    }

  private:
    Frames &frames_;
    uint32_t number_;
};

template <class Qos>
Qos quality(Qos qos, const std::string &kind) {
    const bool is_lossy = kind.rfind("LOSSY", 0) == 0, is_kept = kind.rfind("KEPT", 0) == 0;
    qos.reliability().kind =
        is_lossy ? fast::BEST_EFFORT_RELIABILITY_QOS : fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind =
        is_kept ? fast::TRANSIENT_LOCAL_DURABILITY_QOS : fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = is_kept ? 1 : kDepth;
    qos.endpoint().history_memory_policy = rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    return qos;
}

fast::DomainParticipant *participant_of(uint32_t domain) {
    fast::DomainParticipantQos qos;
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    rtps::Locator_t here;
    rtps::IPLocator::setIPv4(here, 127, 0, 0, 1);
    auto &builtin = qos.wire_protocol().builtin;
    builtin.metatrafficUnicastLocatorList.push_back(here);
    builtin.initialPeersList.push_back(here);
    const std::string enclave = "enclave=/;";  // as each ROS process
    qos.user_data().setValue(std::vector<rtps::octet>(enclave.begin(), enclave.end()));
    return fast::DomainParticipantFactory::get_instance()->create_participant(domain, qos);
}

bool read_whole(void *into, size_t count) {
    return static_cast<bool>(
        std::cin.read(static_cast<char *>(into), static_cast<std::streamsize>(count)));
}

}  // namespace

int main(int count, char **words) {
    if (count < 2 || count % 3 != 2) {
        std::cerr << "usage: fast_dds_node DOMAIN {KIND TOPIC TYPE}..." << std::endl;
        return 2;
    }
    Frames frames;
    fast::DomainParticipant *participant = participant_of(std::stoul(words[1]));
    if (participant == nullptr) {
        std::cerr << "no participant" << std::endl;
        return 1;
    }
    fast::Publisher *publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    fast::Subscriber *subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    std::vector<fast::DataWriter *> writers;
    std::vector<std::unique_ptr<Listener>> listeners;
    std::vector<rtps::GUID_t> guids;
    for (int k = 2; k < count; k += 3) {
        const std::string kind = words[k], name = words[k + 1];
        fast::TypeSupport(new BytesType(words[k + 2])).register_type(participant);
        fast::Topic *topic = participant->create_topic(name, words[k + 2], fast::TOPIC_QOS_DEFAULT);
        writers.push_back(nullptr);
        if (kind.find("WRITER") != std::string::npos) {
            const auto qos = quality(publisher->get_default_datawriter_qos(), kind);
            writers.back() = publisher->create_datawriter(topic, qos);
            guids.push_back(writers.back()->guid());
        } else {
            const auto qos = quality(subscriber->get_default_datareader_qos(), kind);
            listeners.push_back(std::make_unique<Listener>(frames, guids.size()));
            auto *reader = subscriber->create_datareader(topic, qos, listeners.back().get());
            guids.push_back(reader->guid());
        }
    }
    for (size_t number = 0; number < guids.size(); ++number) {
        frames.write_guid(guids.size() + number, guids[number]);
    }
    frames.write_guid(2 * guids.size(), participant->guid());
    uint32_t head[2];
    Bytes message;
    while (read_whole(head, sizeof head) && head[1] <= kMostBytes && head[0] < writers.size()) {
        message.resize(head[1]);
        if (!read_whole(message.data(), head[1]) || writers[head[0]] == nullptr) {
            break;
        }
        if (!writers[head[0]]->write(&message)) {
            std::cerr << "not written: end " << head[0] << std::endl;
        }
    }
    participant->delete_contained_entities();
    fast::DomainParticipantFactory::get_instance()->delete_participant(participant);
    return 0;
}
