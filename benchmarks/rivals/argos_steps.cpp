// The controller and the clock of ARGoS's robots; benchmarks/rivals/argos_steps.py compiles and runs it.
// Its clock prints the simulated robot-seconds and their CPU seconds, and ends the run.
#include <argos3/core/control_interface/ci_controller.h>
#include <argos3/core/simulator/entity/entity.h>
#include <argos3/core/simulator/loop_functions.h>
#include <argos3/plugins/robots/foot-bot/control_interface/ci_footbot_proximity_sensor.h>
#include <argos3/plugins/robots/generic/control_interface/ci_differential_steering_actuator.h>

#include <cmath>
#include <cstdio>
#include <ctime>

using namespace argos;

const Real STEP = 0.1;        // s
const Real WHEEL_BASE = 14.0; // cm, of a foot-bot
const Real SPEED = 20.0;      // cm/s
const Real TURN = 1.0;        // rad/s
const Real AHEAD = 1.0;       // rad to each side

// Drives; turns while a ray ahead meets something.
class Walker : public CCI_Controller {
    CCI_DifferentialSteeringActuator *wheels = nullptr;
    CCI_FootBotProximitySensor *rays = nullptr;

public:
    void Init(TConfigurationNode &) override {
        wheels = GetActuator<CCI_DifferentialSteeringActuator>("differential_steering");
        rays = GetSensor<CCI_FootBotProximitySensor>("footbot_proximity");
    }

    void ControlStep() override {
        bool is_near = false;
        for (const auto &ray : rays->GetReadings())
            is_near = is_near || (std::fabs(ray.Angle.GetValue()) < AHEAD && ray.Value > 0.0);
        const Real turn = TURN * WHEEL_BASE / 2.0;
        wheels->SetLinearVelocity(is_near ? -turn : SPEED, is_near ? turn : SPEED);
    }
};

class Clock : public CLoopFunctions {
    Real robots = 0.0;
    Real seconds = 0.0; // of the processor
    bool is_warm = false;
    std::clock_t start = 0;
    long steps = 0;

public:
    void Init(TConfigurationNode &tree) override {
        GetNodeAttribute(tree, "robots", robots);
        GetNodeAttribute(tree, "seconds", seconds);
        start = std::clock();
    }

    bool IsExperimentFinished() override { // asked before each step
        const Real taken = Real(std::clock() - start) / CLOCKS_PER_SEC;
        if (!is_warm && steps > 0 && taken >= seconds / 2.0) {
            is_warm = true;
            steps = 0;
            start = std::clock();
            return false;
        }
        if (is_warm && steps > 0 && taken >= seconds) {
            std::printf("%g %g\n", robots * steps * STEP, taken);
            std::fflush(stdout);
            return true;
        }
        return false;
    }

    void PostStep() override { ++steps; }
};

REGISTER_CONTROLLER(Walker, "walker")
REGISTER_LOOP_FUNCTIONS(Clock, "clock")
