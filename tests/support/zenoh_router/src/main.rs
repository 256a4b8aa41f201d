//! A Zenoh router with plugins linked in: `zenoh-router -c CONFIG.json5`
//!
//! Feature `zenohd` links the REST and storage plugins, `ros2dds` the plugin of zenoh-bridge-ros2dds, so
//! that the routes, the keys and the liveliness tokens are those of a bridge.

use zenoh::config::Config;
use zenoh::internal::{plugins::PluginsManager, runtime::RuntimeBuilder};

#[tokio::main]
async fn main() {
    zenoh::init_log_from_env_or("z=info");
    let arguments: Vec<String> = std::env::args().collect();
    let [_, option, path] = arguments.as_slice() else {
        fail("usage: zenoh-router -c CONFIG.json5");
    };
    if option != "-c" {
        fail("usage: zenoh-router -c CONFIG.json5");
    }
    let config = Config::from_file(path).unwrap_or_else(|error| fail(&format!("{path}: {error}")));
    let mut plugins = PluginsManager::static_plugins_only();
    #[cfg(feature = "ros2dds")]
    plugins.declare_static_plugin::<zenoh_plugin_ros2dds::ROS2Plugin, &str>("ros2dds", true);
    #[cfg(feature = "zenohd")]
    {
        use zenoh_plugin_storage_manager::StoragesPlugin;
        plugins.declare_static_plugin::<zenoh_plugin_rest::RestPlugin, &str>("rest", true);
        plugins.declare_static_plugin::<StoragesPlugin, &str>("storage_manager", true);
    }
    let building = RuntimeBuilder::new(config).plugins_manager(plugins).build();
    let mut runtime = building.await.unwrap_or_else(|error| fail(&error.to_string()));
    if let Err(error) = runtime.start().await {
        fail(&error.to_string());
    }
    std::future::pending::<()>().await;
}

fn fail(text: &str) -> ! {
    eprintln!("zenoh-router: {text}");
    std::process::exit(1);
}
