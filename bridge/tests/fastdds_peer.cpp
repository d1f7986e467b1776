/* A node that knows nothing of J2A: Fast DDS writes and reads messages as bytes, in hexadecimal.

   usage: fastdds_peer DOMAIN
   standard input:  "sub TOPIC TYPE best|reliable", "pub TOPIC TYPE HEX" (when somebody listens)
                    "stat TOPIC TYPE" (counts, see below), "end"
   standard output: "ready", "got TOPIC HEX", "matched TOPIC USERDATA", "sent TOPIC";
                    "stats COUNT" and a line with the age of each message in us, which bears the time of its sending
                    as an i64 behind one time and one count */
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <chrono>
#include <cstring>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

typedef std::vector<unsigned char> Bytes;

static std::mutex output;

static void say(const std::string &line)
{
    std::lock_guard<std::mutex> lock(output);
    std::cout << line << std::endl;
}

class RawType : public TopicDataType {
public:
    explicit RawType(const std::string &name)
    {
        setName(name.c_str());
        m_typeSize = 1 << 16;
        m_isGetKeyDefined = false;
        auto_fill_type_information(false);
        auto_fill_type_object(false);
    }
    bool serialize(void *data, SerializedPayload_t *payload) override
    {
        const Bytes &bytes = *static_cast<Bytes *>(data);
        memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = bytes.size();
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(SerializedPayload_t *payload, void *data) override
    {
        static_cast<Bytes *>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void *data) override
    {
        return [data]() { return (uint32_t)static_cast<Bytes *>(data)->size(); };
    }
    void *createData() override { return new Bytes; }
    void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
    bool getKey(void *, InstanceHandle_t *, bool) override { return false; }
};

static std::vector<int64_t> ages;

class Counter : public DataReaderListener {
public:
    void on_data_available(DataReader *reader) override
    {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            int64_t sent;
            if (!info.valid_data || bytes.size() < 28)
                continue;
            memcpy(&sent, &bytes[20], sizeof sent);
            auto now = std::chrono::system_clock::now().time_since_epoch();
            int64_t ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
            std::lock_guard<std::mutex> lock(output);
            ages.push_back((ns - sent) / 1000);
        }
    }
};

class Reader : public DataReaderListener {
public:
    explicit Reader(const std::string &topic) : topic_(topic) {}
    void on_data_available(DataReader *reader) override
    {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data)
                continue;
            std::string hex;
            static const char digits[] = "0123456789abcdef";
            for (unsigned char one : bytes) {
                hex += digits[one >> 4];
                hex += digits[one & 15];
            }
            say("got " + topic_ + " " + hex);
        }
    }
    void on_subscription_matched(DataReader *, const SubscriptionMatchedStatus &status) override
    {
        say((status.current_count_change > 0 ? "matched " : "unmatched ") + topic_);
    }

private:
    std::string topic_;
};

int main(int argc, char **argv)
{
    if (argc != 2)
        return 2;
    DomainParticipantQos qos;
    qos.transport().use_builtin_transports = false;
    auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList.push_back("127.0.0.1");
    // What comes while this process does not run is kept here, as the system allows; by default that is 17 ms of
    // 16,000 samples a second.
    udp->receiveBufferSize = 1 << 22;
    qos.transport().user_transports.push_back(udp);
    eprosima::fastrtps::rtps::Locator_t here;
    for (int index = 0; index < 8; index++) {
        eprosima::fastrtps::rtps::IPLocator::setIPv4(here, "127.0.0.1");
        here.port = 7400 + 250 * atoi(argv[1]) + 10 + 2 * index;
        qos.wire_protocol().builtin.initialPeersList.push_back(here);
    }
    DomainParticipant *participant =
        DomainParticipantFactory::get_instance()->create_participant(atoi(argv[1]), qos);
    if (participant == nullptr)
        return 1;
    Publisher *publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
    Subscriber *subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::map<std::string, Topic *> topics;
    std::map<std::string, DataWriter *> writers;
    auto topic_of = [&](const std::string &name, const std::string &type) {
        if (topics.find(name) == topics.end()) {
            TypeSupport support(new RawType(type));
            support.register_type(participant);
            topics[name] = participant->create_topic(name, type, TOPIC_QOS_DEFAULT);
        }
        return topics[name];
    };
    say("ready");
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::string what, name, type, more;
        words >> what >> name >> type >> more;
        if (what == "end") {
            std::lock_guard<std::mutex> lock(output);
            std::cout << "stats " << ages.size() << std::endl;
            for (int64_t age : ages)
                std::cout << age << ' ';
            std::cout << std::endl;
        } else if (what == "stat") {
            DataReaderQos about = DATAREADER_QOS_DEFAULT;
            about.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
            about.history().kind = KEEP_LAST_HISTORY_QOS;
            about.history().depth = 1000;
            subscriber->create_datareader(topic_of(name, type), about, new Counter);
            say("counting " + name);
        } else if (what == "sub") {
            DataReaderQos about = DATAREADER_QOS_DEFAULT;
            about.reliability().kind =
                more == "best" ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
            about.durability().kind =
                more == "latched" ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
            about.history().kind = KEEP_LAST_HISTORY_QOS;
            about.history().depth = 1000;
            subscriber->create_datareader(topic_of(name, type), about, new Reader(name));
        } else if (what == "pub") {
            DataWriter *&writer = writers[name];
            if (writer == nullptr)
                writer = publisher->create_datawriter(topic_of(name, type), DATAWRITER_QOS_DEFAULT);
            PublicationMatchedStatus status;
            for (int i = 0; i < 6000; i++) {
                writer->get_publication_matched_status(status);
                if (status.current_count > 0)
                    break;
                std::this_thread::sleep_for(std::chrono::milliseconds(10));
            }
            Bytes bytes;
            for (size_t at = 0; at + 1 < more.size(); at += 2)
                bytes.push_back((unsigned char)std::stoi(more.substr(at, 2), nullptr, 16));
            writer->write(&bytes);
            say("sent " + name);
        }
    }
    return 0;
}
